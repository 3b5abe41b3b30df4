//! Every key of both presets. A test holds the tables against the configurations themselves.

mod fast;
mod paper;

pub use fast::FAST;
pub use paper::PAPER;

use super::key::Range::{Number, Numbers, OneOf, Positive, Sets, Text, Truth, Whole};
use super::key::{Key, Range, Section};

/// Most environment steps that anything may last.
const STEPS: i64 = 1_000_000_000_000;
const SHARE: Range = Number(0.0, 1.0);
const REWARD: Range = Number(-1e6, 1e6);
const WIDTH: Range = Whole(1, 1024);

const fn key(name: &'static str, unit: &'static str, range: Range, about: &'static str) -> Key {
    Key::new(name, unit, range, about)
}

/// Where a run of any method learns.
pub(crate) const WHERE: [Section; 2] = [
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

const INSTANCES: Key = key(
    "instances",
    "episodes",
    Whole(1, 4096),
    "Episodes that run at the same time; one that ends restarts at once.",
);

const ENVIRONMENT: Section = Section {
    name: "environment",
    about: "The world to learn in.",
    keys: &[
        key("name", "", OneOf(&["save-the-city"]), "Name of the environment."),
        key("set", "", Sets, "Teams and buildings that episodes are drawn from."),
        INSTANCES,
    ],
};

const CONSTANTS: Section = Section {
    name: "environment.constants",
    about: "Numbers of the rules.",
    keys: &[
        key(
            "init_fire_chance",
            "probability",
            SHARE,
            "Chance of each building to burn at the start of an episode.",
        ),
        key(
            "fire_burn_rate",
            "health per step",
            Number(0.0, 100.0),
            "Health lost at full fire and burn rate 1.",
        ),
        key(
            "fire_reduce_rate",
            "fire per step",
            Number(0.0, 100.0),
            "Fire removed per unit of fire speed.",
        ),
        key(
            "fire_growth_rate",
            "factor per step",
            Number(0.0, 100.0),
            "Growth of a fire that nobody attends.",
        ),
        key(
            "base_build_rate",
            "health per step",
            Number(0.0, 100.0),
            "Health gained per unit of build speed.",
        ),
        key(
            "generalist_help_factor",
            "factor",
            Number(0.0, 100.0),
            "A generalist's help, in units of the two rates above.",
        ),
        key("episode_limit", "steps", Whole(1, 100_000), "Steps after which an episode times out."),
        key("end_on_any_burn", "", Truth, "Whether the first burned building ends the episode."),
        key(
            "reward_scale",
            "reward",
            Positive(1e6),
            "What can be earned in an episode, to which rewards are scaled.",
        ),
        key("health_delta_mult", "reward per health", REWARD, "Reward of health gained."),
        key("complete", "reward", REWARD, "Reward of completing a building, to the team only."),
        key("burned_down", "reward", REWARD, "Reward of losing a building."),
        key("extinguish", "reward", REWARD, "Reward of extinguishing a fire."),
        key(
            "solved",
            "reward",
            REWARD,
            "Reward of completing all buildings to the team, of completing one to its task.",
        ),
        key("ts_pen", "reward", REWARD, "Reward of every step."),
    ],
};

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

const fn exploration(steps: &'static str) -> [Key; 4] {
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

pub(crate) const RUN: Section = Section {
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
