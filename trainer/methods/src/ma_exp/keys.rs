//! The keys of MA-Exp.

use sortie_learn::configuration::{Key, Range, Section};

const SHARE: Range = Range::Number(0.0, 1.0);
const VALUE: Range = Range::Number(-1e6, 1e6);

pub(super) const KEYS: &[Section] = &[
    Section {
        name: "heads",
        about: "What is explored for: a policy for each type of intrinsic reward, and one without, which is deployed.",
        keys: &[
            Key::new(
                "intrinsic",
                "",
                Range::OneOf(&[
                    "multi",
                    "none",
                    "independent",
                    "minimum",
                    "covering",
                    "burrowing",
                    "leader-follower",
                    "centralized",
                ]),
                "Types of intrinsic rewards: one, none, or the five that the dissertation chooses among.",
            ),
            Key::new(
                "any",
                "chance",
                SHARE,
                "Chance that an episode is played by any head, whatever it returns; otherwise those that return much are likelier.",
            ),
            Key::new(
                "temperature",
                "reward",
                Range::Positive(1e6),
                "Discounted return by which a head has to be better to be chosen e times as often.",
            ),
            Key::new(
                "until",
                "share of the run",
                SHARE,
                "When only the head without intrinsic rewards acts from.",
            ),
        ],
    },
    Section {
        name: "values",
        about: "What places and actions are worth.",
        keys: &[
            Key::new("discount", "per step", SHARE, "Discount of the team's rewards."),
            Key::new("intrinsic_discount", "per step", SHARE, "Discount of intrinsic rewards."),
            Key::new(
                "start",
                "reward",
                VALUE,
                "What an action is worth in the team's rewards until it is tried. -10 is finding nothing for ever; 0 is so hopeful that agents explore without any intrinsic reward.",
            ),
            Key::new(
                "intrinsic_start",
                "novelty",
                VALUE,
                "What an action is worth in intrinsic rewards until it is tried.",
            ),
            Key::new(
                "intrinsic_weight",
                "reward per novelty",
                Range::Number(0.0, 1e6),
                "What intrinsic values count in the choice of actions.",
            ),
            Key::new(
                "memory",
                "tries",
                Range::Number(1.0, 1e9),
                "Tries of an action that count in what is known of it: partners change.",
            ),
            Key::new(
                "segment",
                "steps",
                Range::Whole(1, 100_000),
                "Steps of an instance after which what it lived through is backed up, the last step first.",
            ),
            Key::new(
                "sweep_every",
                "environment steps",
                Range::Whole(1, 1_000_000_000),
                "Steps after which all that is known is backed up.",
            ),
        ],
    },
    Section {
        name: "exploration",
        about: "How actions are tried out.",
        keys: &[
            Key::new("epsilon", "chance", SHARE, "Chance of a random action."),
            Key::new(
                "last_epsilon",
                "chance",
                SHARE,
                "Chance of a random action once the head without intrinsic rewards acts alone.",
            ),
        ],
    },
    Section {
        name: "audition",
        about: "Frozen policies are tried out one after the other once the head without intrinsic rewards acts alone; the one that returns most is deployed.",
        keys: &[
            Key::new(
                "instances",
                "instances",
                Range::Whole(0, 4096),
                "Instances that play them; the others go on learning. 0: what is known at the end is deployed.",
            ),
            Key::new("episodes", "episodes", Range::Whole(1, 1_000_000), "Episodes of each."),
        ],
    },
];
