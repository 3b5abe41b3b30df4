//! Every key of both learners. A test holds the tables against the presets themselves.

mod fast;
mod paper;

pub(super) use fast::FAST;
pub(super) use paper::PAPER;

use sortie_learn::configuration::Range::{Number, OneOf, Positive, Truth, Whole};
use sortie_learn::configuration::{Key, OPTIMISER, Range, SHARE, STEPS, Section, exploration};

const WIDTH: Range = Whole(1, 1024);

const fn key(name: &'static str, unit: &'static str, range: Range, about: &'static str) -> Key {
    Key::new(name, unit, range, about)
}

const NETWORK_WIDTH: Key =
    key("width", "columns", WIDTH, "Width of embedding and attention, a multiple of the heads.");
const NETWORK_HEADS: Key = key("heads", "heads", Whole(1, 64), "Attention heads.");
const NETWORK_BASE: Key = key("base", "columns", WIDTH, "Width of the layer before the head.");
const NETWORK_INPUTS: Key = key(
    "active_inputs",
    "columns",
    Positive(1e6),
    "Non-zero inputs that the initial weights of the first layer are sized for; rows are mostly zeros.",
);

const NETWORK_SKIP: Key = key(
    "skip",
    "",
    Truth,
    "Whether the own row's embedding is added to what the attention gives, past it; not in the dissertation.",
);

const REPLAY: &[Key] = &[
    key(
        "capacity",
        "samples",
        Whole(1, 20_000_000),
        "Samples kept: records of one step and one building's team, or decisions of the allocator.",
    ),
    key("batch", "samples", Whole(1, 65_536), "Samples in an update."),
    key(
        "steps_per_update",
        "environment steps",
        Whole(1, STEPS),
        "Steps from one update to the next.",
    ),
    key(
        "warm_up",
        "samples",
        Whole(1, 20_000_000),
        "Samples that must be there before the first update.",
    ),
    key(
        "symmetries",
        "",
        Truth,
        "Whether every drawn sample is turned and mirrored at random, which changes no truth.",
    ),
];

const RETURNS: &[Key] = &[
    key("steps", "steps", Whole(1, 1000), "Steps before a target bootstraps."),
    key("discount", "factor per step", SHARE, "Worth of a reward one step later."),
    key(
        "shaping",
        "reward per cell",
        Number(-100.0, 100.0),
        "Potential between an agent and its building, or the nearest open one; 0 turns shaping off.",
    ),
];
