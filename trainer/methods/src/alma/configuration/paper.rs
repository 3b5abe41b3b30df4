//! The keys of the preset `paper`.

use super::*;

const SCHEDULE: &[Key] = &[
    key("start", "probability", SHARE, "Before the first step."),
    key("end", "probability", SHARE, "From step `steps` on."),
    key("steps", "environment steps", Whole(0, STEPS), "Length of the way."),
];

/// The keys of the preset `paper`.
pub(in crate::alma) const PAPER: &[Section] = &[
    Section {
        name: "",
        about: "What is learned from.",
        keys: &[key(
            "learner",
            "",
            OneOf(&["windows"]),
            "Windows of whole episodes, which tells this file from those of the preset `fast`.",
        )],
    },
    Section {
        name: "low_level",
        about: "The agents' utilities, their mixer, and how both learn.",
        keys: &[
            key(
                "conditioning",
                "",
                OneOf(&["mask", "input", "none"]),
                "What agents and mixer see of the subtasks.",
            ),
            key(
                "extra_tasks",
                "subtasks",
                Whole(0, 64),
                "Spare subtask marks, shuffled in with the others.",
            ),
            NETWORK_WIDTH,
            NETWORK_HEADS,
            NETWORK_BASE,
            key(
                "active_inputs",
                "columns",
                Number(0.0, 1e6),
                "Inputs of an entity that are not zero, by which first weights are drawn; 0 counts them all, as PyTorch does.",
            ),
            NETWORK_SKIP,
            key(
                "recurrent",
                "",
                Truth,
                "Whether the agents have a memory, emptied when an episode ends.",
            ),
            key(
                "hypernetwork_width",
                "columns",
                WIDTH,
                "Width of the hypernetworks' embedding and attention, a multiple of their heads.",
            ),
            key(
                "hypernetwork_heads",
                "heads",
                Whole(1, 64),
                "Heads of the hypernetworks' attention.",
            ),
            key("mixing", "columns", WIDTH, "Width between the mixer's two layers."),
            key(
                "nonnegative",
                "",
                OneOf(&["softmax", "absolute"]),
                "How mixing weights are kept from being negative.",
            ),
            key(
                "bias_nonnegative",
                "",
                Truth,
                "Whether mixing biases go through absolute values, as in the public code of ALMA.",
            ),
            key(
                "popart_per_task",
                "",
                Truth,
                "Whether each subtask has a PopArt head of its own, as in the public code.",
            ),
            key(
                "popart_order",
                "",
                OneOf(&["rescale-first", "reference"]),
                "When the PopArt head is rescaled: before values are computed, or as the public code does.",
            ),
            key(
                "frozen",
                "",
                Truth,
                "Whether the agents stay as they are: only the allocator learns.",
            ),
            key(
                "task_availability",
                "",
                Truth,
                "Whether actions that apply to a subtask are available to the agents allocated to it only.",
            ),
            key(
                "learning_rate",
                "step of RMSprop",
                Number(0.0, 1000.0),
                "Learning rate of RMSprop, of both levels.",
            ),
            key(
                "clip",
                "norm",
                Positive(1e9),
                "Largest norm of the gradient; a longer one is shortened.",
            ),
        ],
    },
    Section { name: "low_level.returns", about: "How rewards become targets.", keys: RETURNS },
    Section {
        name: "coach",
        about: "Who tells agents without subtasks what to do: COPA.",
        keys: &[
            key("enabled", "", Truth, "Whether there is a coach."),
            key(
                "beta",
                "weight",
                Number(0.0, 1e6),
                "Weight of the recognition's term of the loss; the coach's entropy weighs a tenth.",
            ),
        ],
    },
    Section {
        name: "allocation",
        about: "Who allocates, and how that is learned.",
        keys: &[
            key(
                "by",
                "",
                OneOf(&["learned", "heuristic", "coordinated", "random"]),
                "The learned allocator, or a rule.",
            ),
            key(
                "interval",
                "steps",
                Whole(1, 100_000),
                "Steps between decisions, unless the open tasks change; those of a coach too.",
            ),
            key(
                "proposals",
                "allocations",
                Whole(1, 4096),
                "Allocations that are proposed for a decision.",
            ),
            key(
                "width",
                "columns",
                WIDTH,
                "Width of embedding and attention of proposal policy and critic, a multiple of their heads.",
            ),
            key("heads", "heads", Whole(1, 64), "Their attention heads."),
            key(
                "extra_tasks",
                "subtasks",
                Whole(0, 64),
                "Spare subtasks, so that the networks serve worlds with more of them.",
            ),
            key("discount", "factor per decision", SHARE, "Worth of a reward one decision later."),
            key("entropy", "weight", Number(0.0, 1e6), "Weight of the proposal policy's entropy."),
            key(
                "oldest",
                "environment steps",
                Whole(1, STEPS),
                "Age from which an episode teaches the allocator nothing.",
            ),
            key("rows", "decisions", Whole(2, 100_000), "Decisions in an update, at most."),
        ],
    },
    Section {
        name: "exploration.actions",
        about: "How often an agent takes a random available action.",
        keys: SCHEDULE,
    },
    Section {
        name: "exploration.proposal",
        about: "How often a decision takes the first proposal instead of the critic's best.",
        keys: SCHEDULE,
    },
    Section {
        name: "exploration.allocation",
        about: "How often an agent is given a random open subtask at a decision.",
        keys: SCHEDULE,
    },
    Section {
        name: "learning",
        about: "What is kept, and how often is learned from it.",
        keys: &[
            key("episodes", "episodes", Whole(1, 1_000_000), "Episodes kept."),
            key(
                "windows",
                "windows",
                Whole(1, 4096),
                "Episodes drawn and windows cut for an update.",
            ),
            key("steps", "states", Whole(2, 10_000), "States of a window."),
            key("updates", "updates", Whole(0, 10_000), "Updates for every episode."),
            key(
                "copy_agents_every",
                "episodes",
                Whole(1, STEPS),
                "When the target of the agents and their mixer is renewed.",
            ),
            key(
                "copy_critic_every",
                "episodes",
                Whole(1, STEPS),
                "When the target of the critic is renewed.",
            ),
        ],
    },
];
