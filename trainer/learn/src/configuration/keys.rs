//! The keys that runs of several methods have.

use super::key::Range::{Number, Numbers, OneOf, Positive, Text, Whole};
use super::key::{Key, Range, Section};

/// Most environment steps that anything may last.
pub const STEPS: i64 = 1_000_000_000_000;
/// A share or a probability.
pub const SHARE: Range = Number(0.0, 1.0);

const fn key(name: &'static str, unit: &'static str, range: Range, about: &'static str) -> Key {
    Key::new(name, unit, range, about)
}

/// Where a run of any method learns.
pub const WHERE: [Section; 2] = [
    Section {
        name: "environment",
        about: "The world to learn in.",
        keys: &[
            key("name", "", Text, "Name of the environment."),
            key("set", "", Text, "Starts that episodes are drawn from; empty for the default."),
            INSTANCES,
        ],
    },
    Section {
        name: "environment.settings",
        about: "Numbers of the rules that differ from the usual ones; which there are is up to the environment.",
        keys: &[],
    },
];

/// Episodes that run at the same time.
pub const INSTANCES: Key = key(
    "instances",
    "episodes",
    Whole(1, 4096),
    "Episodes that run at the same time; one that ends restarts at once, or with all others where whole episodes are learned from.",
);

/// The keys of [`OptimiserConfig`](super::OptimiserConfig).
pub const OPTIMISER: &[Key] = &[
    key("learning_rate", "step of Adam", Number(0.0, 1000.0), "Learning rate of Adam."),
    key(
        "learning_rate_end",
        "step of Adam",
        Number(0.0, 1000.0),
        "Learning rate at the end of the run.",
    ),
    key(
        "decay_from",
        "share of the run",
        SHARE,
        "When the learning rate begins to go to its end, in a straight line.",
    ),
    key("epsilon", "slope", Positive(1.0), "Added to Adam's denominator."),
    key("clip", "norm", Positive(1e9), "Largest norm of the gradient; a longer one is shortened."),
    key(
        "target_rate",
        "share per update",
        SHARE,
        "How far the target network moves towards the weights.",
    ),
    key(
        "average_rate",
        "share per update",
        SHARE,
        "How far the averaged weights move, which are evaluated and shipped.",
    ),
];

/// The keys of [`ExplorationConfig`](super::ExplorationConfig).
pub const EXPLORATION: &[Key] = &exploration("Length of the way down.");

/// The keys of exploration, with a sentence about its way down.
pub const fn exploration(steps: &'static str) -> [Key; 4] {
    [
        key("start", "probability", SHARE, "At the first step."),
        key("end", "probability", SHARE, "From step `steps` on."),
        key("steps", "environment steps", Whole(0, STEPS), steps),
        key(
            "spread",
            "factor",
            Numbers(0.0, 100.0),
            "Factors on the probability, dealt to the instances in turn: some act greedily, some more wildly.",
        ),
    ]
}

/// How long a run of any method learns.
pub const RUN: Section = Section {
    name: "run",
    about: "How long to learn, and when to measure and save.",
    keys: &[
        key(
            "from",
            "",
            Text,
            "Folder of a run whose weights this one begins with; empty for a run from scratch.",
        ),
        key(
            "products",
            "",
            OneOf(&["widest", "avx512", "avx2", "neon", "plain"]),
            "Instructions of matrix products, which decide the last bits of every result; `widest`, what the processor \
             has, becomes the name of what that is as soon as a run begins.",
        ),
        key("steps", "environment steps", Whole(1, STEPS), "How long to learn."),
        key(
            "evaluate_every",
            "environment steps",
            Whole(1, STEPS),
            "From one evaluation, and checkpoint, to the next.",
        ),
        key(
            "evaluate_episodes",
            "episodes",
            Whole(1, 1_000_000),
            "Greedy episodes of an evaluation.",
        ),
        key(
            "final_episodes",
            "episodes",
            Whole(0, 1_000_000),
            "Greedy episodes of the evaluation at the end, fresh ones that were never used before; 0 leaves it out.",
        ),
        key(
            "checkpoint_minutes",
            "minutes",
            Positive(1e6),
            "From one checkpoint to the next, besides those of evaluations.",
        ),
    ],
};
