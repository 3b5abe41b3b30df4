//! The keys of MAAC.

use sortie_learn::configuration::{Key, Range, Section};

const SHARE: Range = Range::Number(0.0, 1.0);
const ANY: Range = Range::Number(0.0, 1e6);
const WIDTH: Range = Range::Whole(4, 1024);
const SIZE: Range = Range::Whole(1, 20_000_000);

pub(super) const KEYS: &[Section] = &[
    Section {
        name: "network",
        about: "Policies, and the critic that learns with them.",
        keys: &[
            Key::new(
                "critic_width",
                "columns",
                WIDTH,
                "Width of the critic's layers, a multiple of its heads.",
            ),
            Key::new("policy_width", "columns", WIDTH, "Width of the policies' layers."),
            Key::new("heads", "heads", Range::Whole(1, 64), "Attention heads of the critic."),
            Key::new(
                "attention",
                "",
                Range::OneOf(&["learned", "uniform"]),
                "Whether the critic learns what the others count (MAAC), or all count the same (MAAC (Uniform)).",
            ),
            Key::new(
                "shared",
                "",
                Range::Truth,
                "Whether agents of a role share their networks; each has its own otherwise.",
            ),
            Key::new(
                "identity",
                "",
                Range::Truth,
                "Whether agents that share networks are told which of them they are.",
            ),
            Key::new(
                "normalised",
                "",
                Range::Truth,
                "Whether inputs are normalised over the batch.",
            ),
            Key::new(
                "input_scale",
                "factor",
                ANY,
                "What inputs that are not normalised are multiplied with.",
            ),
        ],
    },
    Section {
        name: "returns",
        about: "How rewards become targets.",
        keys: &[
            Key::new(
                "steps",
                "decisions",
                Range::Whole(1, 1000),
                "Decisions before a target bootstraps.",
            ),
            Key::new("discount", "factor per step", SHARE, "Worth of a reward one step later."),
            Key::new(
                "decision_interval",
                "steps",
                Range::Whole(1, 1000),
                "Steps that an action is held for while learning; teams that are measured decide at every step.",
            ),
            Key::new(
                "shaping",
                "reward per unit",
                ANY,
                "Scale of the environment's potential, whose rise is added to rewards while learning; 0: nothing is.",
            ),
        ],
    },
    Section {
        name: "replay",
        about: "What is kept, and how much of it an update sees.",
        keys: &[
            Key::new("capacity", "decisions", SIZE, "Kept, of all instances."),
            Key::new("first", "decisions", SIZE, "Kept before the first update."),
            Key::new("batch", "decisions", Range::Whole(1, 65_536), "In an update."),
            Key::new(
                "steps_per_period",
                "environment steps",
                SIZE,
                "Steps from one period of updates to the next.",
            ),
            Key::new(
                "updates_per_period",
                "updates",
                Range::Whole(1, 1000),
                "Updates of a period.",
            ),
        ],
    },
    Section {
        name: "entropy",
        about: "How much chance in the choice of actions is worth, in deviations of rewards.",
        keys: &[
            Key::new("start", "", ANY, "At first."),
            Key::new("end", "", ANY, "After `steps`, and from there on."),
            Key::new(
                "steps",
                "environment steps",
                Range::Whole(0, 20_000_000_000),
                "Steps in which it falls, by the same factor each.",
            ),
        ],
    },
    Section {
        name: "optimiser",
        about: "How the weights follow the gradient, by Adam.",
        keys: &[
            Key::new("critic_rate", "", SHARE, "Step size of the critic."),
            Key::new("policy_rate", "", SHARE, "Step size of the policies."),
            Key::new(
                "target_rate",
                "share",
                SHARE,
                "Share of the way that targets move in an update.",
            ),
            Key::new(
                "average_rate",
                "share",
                SHARE,
                "Share of the way that the policies that are measured move in an update.",
            ),
            Key::new(
                "weight_decay",
                "",
                SHARE,
                "What a weight of the critic adds to its gradient.",
            ),
            Key::new(
                "critic_clip",
                "",
                ANY,
                "Largest norm of the critic's gradient, for each agent.",
            ),
            Key::new("policy_clip", "", ANY, "Largest norm of the gradient of a policy."),
            Key::new("epsilon", "", SHARE, "Added to Adam's denominator."),
            Key::new(
                "early_epsilon",
                "",
                Range::Truth,
                "Whether that is added before the correction of first steps, as PyTorch did until version 1.2.",
            ),
        ],
    },
    Section {
        name: "update",
        about: "What an update computes.",
        keys: &[
            Key::new(
                "own_actions",
                "",
                Range::OneOf(&["expected", "drawn"]),
                "How an agent's own action counts in targets and policies: all by their chances, or one that is drawn.",
            ),
            Key::new(
                "policy_values",
                "",
                Range::OneOf(&["kept", "fresh"]),
                "What policies learn from: the values that the critic's update computed, or those of the updated critic for actions that all draw anew.",
            ),
            Key::new("score_penalty", "", ANY, "What the mean squared score of an action counts."),
            Key::new(
                "attention_penalty",
                "",
                ANY,
                "What the mean squared score of attention counts.",
            ),
        ],
    },
];
