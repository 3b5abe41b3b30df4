//! The keys of the methods.

use sortie_learn::configuration::{EXPLORATION, Key, OPTIMISER, Range, Section};

const SHARE: Range = Range::Number(0.0, 1.0);
const SIZE: i64 = 20_000_000;

pub(super) const KEYS: &[Section] = &[
    Section {
        name: "network",
        about: "The agents' network, and the hypernetwork of the mixer.",
        keys: &[
            Key::new(
                "width",
                "columns",
                Range::Whole(16, 128),
                "Width of embedding and attention: 16, 32, 64 or 128.",
            ),
            Key::new(
                "active_inputs",
                "columns",
                Range::Whole(0, 1024),
                "Non-zero inputs that the first weights are sized for, as rows are mostly zeros; 0: all columns.",
            ),
            Key::new(
                "skip",
                "",
                Range::Truth,
                "Whether an agent's own embedding reaches the layer before the head, past the attention.",
            ),
            Key::new(
                "memory",
                "columns",
                Range::Whole(0, 1024),
                "Width of what agents remember in a gated recurrent unit, which needs `replay.unit=episodes`; 0: nothing.",
            ),
        ],
    },
    Section {
        name: "mixer",
        about: "How the utilities of a team become its value.",
        keys: &[
            Key::new(
                "kind",
                "",
                Range::OneOf(&["sum", "linear", "qmix"]),
                "Their sum (VDN), a weighted sum and a value of the state, or two layers with non-negative weights (QMIX).",
            ),
            Key::new(
                "hypernetworks",
                "",
                Range::OneOf(&["shared", "separate"]),
                "Whether one network makes all numbers that are mixed with, or one each kind: weights, biases, value.",
            ),
            Key::new(
                "mixing",
                "columns",
                Range::Whole(1, 1024),
                "Width between the layers of `qmix`.",
            ),
        ],
    },
    Section {
        name: "imagination",
        about: "Utilities of agents that see only their part of a partition, or only the rest, mixed to the same value.",
        keys: &[
            Key::new(
                "partitions",
                "",
                Range::OneOf(&["none", "drawn", "companions", "drawn-companions"]),
                "None, drawn anew for every use of a state (REFIL), who truly belongs together (fixed oracle), or both (randomised oracle).",
            ),
            Key::new("share", "share of the loss", SHARE, "What imagined values count."),
        ],
    },
    Section {
        name: "returns",
        about: "How rewards become targets.",
        keys: &[
            Key::new("steps", "steps", Range::Whole(1, 1000), "Steps before a target bootstraps."),
            Key::new("discount", "factor per step", SHARE, "Worth of a reward one step later."),
        ],
    },
    Section {
        name: "replay",
        about: "What is kept, and how much of it an update sees.",
        keys: &[
            Key::new(
                "unit",
                "",
                Range::OneOf(&["steps", "episodes"]),
                "What is kept and drawn: single states with what followed them, or whole episodes.",
            ),
            Key::new("capacity", "units", Range::Whole(1, SIZE), "Kept, of all instances."),
            Key::new("batch", "units", Range::Whole(1, 65_536), "In an update."),
            Key::new(
                "steps_per_update",
                "environment steps",
                Range::Whole(0, SIZE),
                "Steps from one update to the next; 0: an update for each episode that ends.",
            ),
        ],
    },
    Section {
        name: "exploration",
        about: "How often agents take a random available action.",
        keys: EXPLORATION,
    },
    Section { name: "optimiser", about: "How the weights follow the gradient.", keys: OPTIMISER },
    Section {
        name: "update",
        about: "What follows the gradient, and the weights.",
        keys: &[
            Key::new(
                "rule",
                "",
                Range::OneOf(&["adam", "rmsprop"]),
                "How weights follow the gradient. RMSprop has a decay of 0.99 and adds 1e-5 to its denominator.",
            ),
            Key::new(
                "target_every",
                "updates",
                Range::Whole(1, SIZE),
                "Updates from one move of the target network to the next.",
            ),
        ],
    },
];
