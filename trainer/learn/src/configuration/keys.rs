//! Every key of both presets. A test holds the tables against the configurations themselves.

use super::key::Range::{Number, Numbers, OneOf, Positive, Sets, Text, Truth, Whole};
use super::key::{Key, Range, Section};

/// Most environment steps that anything may last.
const STEPS: i64 = 1_000_000_000_000;
const SHARE: Range = Number(0.0, 1.0);
const REWARD: Range = Number(-1e6, 1e6);
const WIDTH: Range = Whole(1, 1024);

const fn key(name: &'static str, unit: &'static str, range: Range, about: &'static str) -> Key {
    Key { name, unit, range, about }
}

const ENVIRONMENT: Section = Section {
    name: "environment",
    about: "The world to learn in.",
    keys: &[
        key("name", "", OneOf(&["save-the-city"]), "Name of the environment."),
        key("set", "", Sets, "Teams and buildings that episodes are drawn from."),
        key(
            "instances",
            "episodes",
            Whole(1, 4096),
            "Episodes that run at the same time; one that ends restarts at once.",
        ),
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

const REPLAY: &[Key] = &[
    key(
        "capacity",
        "samples",
        Whole(1, 100_000_000),
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
        Whole(1, 100_000_000),
        "Samples that must be there before the first update.",
    ),
    key(
        "symmetries",
        "",
        Truth,
        "Whether every drawn sample is turned and mirrored at random, which changes no truth.",
    ),
];

const OPTIMISER: &[Key] = &[
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

const RUN: Section = Section {
    name: "run",
    about: "How long to learn, and when to measure and save.",
    keys: &[
        key(
            "from",
            "",
            Text,
            "Folder of a run whose weights this one begins with; empty for a run from scratch.",
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

/// The keys of the preset `fast`.
pub const FAST: &[Section] = &[
    ENVIRONMENT,
    CONSTANTS,
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
        keys: &[
            key("start", "probability", SHARE, "At the first step."),
            key("end", "probability", SHARE, "From step `steps` on."),
            key(
                "steps",
                "environment steps",
                Whole(0, STEPS),
                "Length of the way down. Unless set, a run of less than 600,000 steps shrinks it in proportion.",
            ),
            key(
                "spread",
                "factor",
                Numbers(0.0, 100.0),
                "Factors on the probability, dealt to the instances in turn: some act greedily, some more wildly.",
            ),
        ],
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
        keys: &[NETWORK_WIDTH, NETWORK_HEADS, NETWORK_BASE, NETWORK_INPUTS],
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
    RUN,
];

const SCHEDULE: &[Key] = &[
    key("start", "probability", SHARE, "Before the first step."),
    key("end", "probability", SHARE, "From step `steps` on."),
    key("steps", "environment steps", Whole(0, STEPS), "Length of the way."),
];

/// The keys of the preset `paper`.
pub const PAPER: &[Section] = &[
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
    ENVIRONMENT,
    CONSTANTS,
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
    RUN,
];
