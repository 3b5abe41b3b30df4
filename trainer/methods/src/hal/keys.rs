//! The keys of the methods.

use sortie_learn::configuration::{Key, OPTIMISER, Range, SHARE, Section};

const SIZE: i64 = 20_000_000;

const fn key(name: &'static str, unit: &'static str, range: Range, about: &'static str) -> Key {
    Key::new(name, unit, range, about)
}

pub(super) const KEYS: &[Section] = &[
    Section {
        name: "network",
        about: "What the three networks are shown, and how wide they are.",
        keys: &[
            key(
                "crop",
                "cells",
                Range::Whole(1, 15),
                "Cells around the agent, each way across, that are shown one by one; odd.",
            ),
            key("nearest", "", Range::Truth, "Whether the nearest cell of every kind is shown."),
            key(
                "width",
                "columns",
                Range::Whole(8, 1024),
                "Width of the two hidden layers, a multiple of 8.",
            ),
            key(
                "active_inputs",
                "columns",
                Range::Whole(1, 4096),
                "Inputs that differ from zero, which the first weights are sized for.",
            ),
        ],
    },
    Section {
        name: "affordances",
        about: "Which milestones can be gone for.",
        keys: &[
            key(
                "mask",
                "",
                Range::OneOf(&["learned", "oracle", "none"]),
                "What hides milestones: a classifier, the truth, or nothing.",
            ),
            key(
                "threshold",
                "likelihood",
                Range::Number(0.001, 0.999),
                "From where on a milestone counts as afforded.",
            ),
            key(
                "filter",
                "",
                Range::Truth,
                "Whether negatives that look like positives are left out.",
            ),
            key(
                "every",
                "updates",
                Range::Whole(1, SIZE),
                "Updates of the controller for each of the classifier.",
            ),
            key(
                "kept",
                "states",
                Range::Whole(1, SIZE),
                "Kept of each milestone, reached and missed.",
            ),
            key(
                "triplets",
                "triplets",
                Range::Whole(0, 65_536),
                "That shape the embedding in an update.",
            ),
            key(
                "spread",
                "steps",
                Range::Number(0.5, 1000.0),
                "How far apart states of a triplet that belong together are, a deviation.",
            ),
            key("batch", "states", Range::Whole(1, 65_536), "Of each milestone in an update."),
            key(
                "population",
                "states",
                Range::Whole(2, 65_536),
                "Positives on each side that tell how far apart positives are.",
            ),
        ],
    },
    Section {
        name: "returns",
        about: "How what the controller does becomes targets.",
        keys: &[
            key(
                "option_steps",
                "steps",
                Range::Whole(1, 254),
                "Steps after which an option is over without a milestone.",
            ),
            key("steps", "steps", Range::Whole(1, 254), "Steps before a target bootstraps."),
            key("discount", "factor per step", SHARE, "Worth of a milestone one step later."),
            key(
                "relabel",
                "",
                Range::Truth,
                "Whether what an option reached is learned from as if it had been its goal.",
            ),
            key(
                "no_operations",
                "",
                Range::Truth,
                "Whether actions that change nothing are worth nothing.",
            ),
            key(
                "mirror",
                "",
                Range::Truth,
                "Whether states are shown left for right half of the time.",
            ),
        ],
    },
    Section {
        name: "meta",
        about: "How the meta-controller learns.",
        keys: &[
            key("options", "options", Range::Whole(1, 1000), "Options before a target bootstraps."),
            key("discount", "factor per option", SHARE, "Worth of the task one option later."),
            key(
                "step_discount",
                "factor per step",
                SHARE,
                "Worth of the task one environment step later, besides.",
            ),
            key("batch", "options", Range::Whole(1, 65_536), "In an update."),
            key("solved", "share", SHARE, "Of them, drawn from episodes that were solved."),
        ],
    },
    Section {
        name: "replay",
        about: "What is kept, and how much of it an update of the controller sees.",
        keys: &[
            key("capacity", "steps", Range::Whole(1, 1_000_000_000), "Kept, of all instances."),
            key("batch", "steps", Range::Whole(1, 65_536), "In an update."),
            key(
                "reached",
                "share",
                SHARE,
                "Of them, drawn from options that reached a milestone, every milestone as often.",
            ),
            key(
                "steps_per_update",
                "environment steps",
                Range::Whole(1, SIZE),
                "From one update to the next.",
            ),
        ],
    },
    Section {
        name: "exploration",
        about: "How much is tried out: from the first chance to the second in a straight line.",
        keys: &[
            key(
                "first",
                "environment steps",
                Range::Whole(0, SIZE),
                "In which everything is drawn.",
            ),
            key("share", "share of the run", SHARE, "Over which chances change."),
            key("actions", "probability", Range::Numbers(0.0, 1.0), "Of a random action."),
            key("goals", "probability", Range::Numbers(0.0, 1.0), "Of any milestone as a goal."),
            key(
                "afforded",
                "probability",
                Range::Numbers(0.0, 1.0),
                "Of a goal that is drawn from the mask, what was seldom reached more often.",
            ),
        ],
    },
    Section {
        name: "measured",
        about: "How much of chance is left where agents are measured.",
        keys: &[
            key("actions", "probability", SHARE, "Of a random action."),
            key(
                "goals",
                "probability",
                SHARE,
                "Of a random goal, from the mask where there is one.",
            ),
            key(
                "varied",
                "",
                Range::Truth,
                "Whether a view that is met again within an option is answered by the next best action, and a goal that was missed waits for others.",
            ),
        ],
    },
    Section { name: "optimiser", about: "How the weights follow the gradient.", keys: OPTIMISER },
];
