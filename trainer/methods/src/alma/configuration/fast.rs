//! The keys of the preset `fast`.

use super::*;

/// The keys of the preset `fast`.
pub(in crate::alma) const FAST: &[Section] = &[
    Section {
        name: "allocation",
        about: "Who assigns agents to buildings: a training episode draws its allocator by these weights.",
        keys: &[
            key(
                "learned",
                "weight",
                Number(0.0, 1e6),
                "Weight of the allocator that the run learns; with 0 it learns none.",
            ),
            key(
                "coordinated",
                "weight",
                Number(0.0, 1e6),
                "Weight of the hand-written rule that looks at the whole team.",
            ),
            key("heuristic", "weight", Number(0.0, 1e6), "Weight of the dissertation's heuristic."),
            key("random", "weight", Number(0.0, 1e6), "Weight of uniform assignment."),
            key(
                "interval",
                "steps",
                Whole(1, 100_000),
                "Steps between decisions, unless the open tasks change.",
            ),
            key(
                "team_max",
                "agents",
                Whole(1, 64),
                "Largest team that the learned allocator sends to one building.",
            ),
        ],
    },
    Section {
        name: "network",
        about: "The agents' network.",
        keys: &[
            key(
                "subtask",
                "",
                OneOf(&["mask", "input", "none"]),
                "What agents see of the subtasks: their own only, everything with marks, or no subtasks.",
            ),
            NETWORK_WIDTH,
            NETWORK_HEADS,
            NETWORK_BASE,
            NETWORK_INPUTS,
            NETWORK_SKIP,
        ],
    },
    Section {
        name: "mixer",
        about: "How the utilities of a team become its value.",
        keys: &[
            key(
                "kind",
                "",
                OneOf(&["sum", "linear", "qmix"]),
                "Their sum (VDN), a weighted sum, or two layers with non-negative weights (QMIX).",
            ),
            key(
                "width",
                "columns",
                WIDTH,
                "Width of embedding and attention of the hypernetwork that `linear` and `qmix` have, a multiple of its heads.",
            ),
            key("heads", "heads", Whole(1, 64), "Its attention heads."),
            key("mixing", "columns", WIDTH, "Width between the two layers of `qmix`."),
            key(
                "reward_scale",
                "factor",
                Positive(1e6),
                "Factor on the rewards under `qmix`, whose layers shrink values at first.",
            ),
        ],
    },
    Section { name: "returns", about: "How rewards become targets.", keys: RETURNS },
    Section {
        name: "replay",
        about: "What the agents keep, and how much of it an update sees.",
        keys: REPLAY,
    },
    Section {
        name: "exploration",
        about: "How often agents take a random available action.",
        keys: &exploration(
            "Length of the way down. Unless set, a run of less than 600,000 steps shrinks it in proportion.",
        ),
    },
    Section {
        name: "optimiser",
        about: "How the agents' weights follow the gradient.",
        keys: OPTIMISER,
    },
    Section {
        name: "allocator",
        about: "How the allocator learns. Until it decides, hand-written rules do.",
        keys: &[
            key(
                "learns_from",
                "environment steps",
                Whole(0, STEPS),
                "When it begins to learn. Unless set, a run of less than 600,000 steps shrinks it in proportion.",
            ),
            key(
                "decides_from",
                "environment steps",
                Whole(0, STEPS),
                "When it begins to decide. Unless set, a run of less than 600,000 steps shrinks it in proportion.",
            ),
            key("discount", "factor per step", SHARE, "Worth of a reward one step later."),
            key(
                "moved",
                "share of the agents",
                SHARE,
                "Who is moved to a random open building in a decision to explore.",
            ),
            key(
                "moved_decisions",
                "share of the decisions",
                SHARE,
                "How often agents are moved at all.",
            ),
        ],
    },
    Section {
        name: "allocator.network",
        about: "The team-value network.",
        keys: &[NETWORK_WIDTH, NETWORK_HEADS, NETWORK_BASE, NETWORK_INPUTS, NETWORK_SKIP],
    },
    Section {
        name: "allocator.replay",
        about: "What the allocator keeps, and how much of it an update sees.",
        keys: REPLAY,
    },
    Section {
        name: "allocator.optimiser",
        about: "How the allocator's weights follow the gradient.",
        keys: OPTIMISER,
    },
];
