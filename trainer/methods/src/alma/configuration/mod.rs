//! Every key of both presets. A test holds the tables against the configurations themselves.

mod fast;
mod paper;

pub use fast::FAST;
pub use paper::PAPER;

use sortie_envs::save_the_city::ScenarioSet;
use sortie_learn::configuration::Range::{Number, OneOf, Positive, Said, Truth, Whole};
use sortie_learn::configuration::{
    INSTANCES, Key, OPTIMISER, RUN, Range, SHARE, STEPS, Section, exploration,
};

const REWARD: Range = Number(-1e6, 1e6);
const WIDTH: Range = Whole(1, 1024);
const SETS: Range = Said(is_set, "scenario sets such as `2-5a_2-5b`, joined by `+`");

fn is_set(name: &str) -> bool {
    ScenarioSet::named(name).is_ok()
}

const fn key(name: &'static str, unit: &'static str, range: Range, about: &'static str) -> Key {
    Key::new(name, unit, range, about)
}

const ENVIRONMENT: Section = Section {
    name: "environment",
    about: "The world to learn in.",
    keys: &[
        key("name", "", OneOf(&["save-the-city"]), "Name of the environment."),
        key("set", "", SETS, "Teams and buildings that episodes are drawn from."),
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

#[cfg(test)]
mod tests {
    use sortie_learn::configuration::{Kept, check_values, from_toml, paths, replaced, table_of};
    use toml::{Table, Value};

    use crate::alma::{records, windows};

    /// Every key of a configuration stands in its table, and its default is within its limits.
    fn is_complete<C: Kept>() {
        fn collect(within: &str, table: &Table, to: &mut Vec<String>) {
            for (name, value) in table {
                let path =
                    if within.is_empty() { name.clone() } else { format!("{within}.{name}") };
                match value {
                    Value::Table(inner) => collect(&path, inner, to),
                    _ => to.push(path),
                }
            }
        }
        let table = table_of(&C::default()).unwrap();
        check_values(&C::default()).unwrap();
        let (mut there, mut known) = (Vec::new(), paths(C::SECTIONS).collect::<Vec<_>>());
        collect("", &table, &mut there);
        there.sort();
        known.sort();
        assert_eq!(there, known);
        for section in C::SECTIONS {
            assert!(section.about.ends_with('.'), "{}", section.name);
            for key in section.keys {
                assert!(key.about.ends_with('.') && !key.about.contains('|'), "{}", key.name);
            }
        }
    }

    #[test]
    fn every_key_is_described() {
        is_complete::<records::Config>();
        is_complete::<windows::Config>();
    }

    #[test]
    fn values_without_sense_are_refused_by_key_value_and_range() {
        for (assignment, parts) in [
            ("optimiser.learning_rate=NaN", ["`optimiser.learning_rate`", "nan", "0 to 1000"]),
            ("optimiser.learning_rate=1e30", ["`optimiser.learning_rate`", "1", "0 to 1000"]),
            ("optimiser.clip=-1", ["`optimiser.clip`", "-1", "above 0"]),
            ("optimiser.target_rate=5", ["`optimiser.target_rate`", "5", "0 to 1"]),
            ("exploration.start=7", ["`exploration.start`", "7", "0 to 1"]),
            ("environment.set=foo", ["`environment.set`", "foo", "2-5a_2-5b"]),
            ("environment.constants.reward_scale=0", ["reward_scale`", "0", "above 0"]),
            ("run.checkpoint_minutes=NaN", ["`run.checkpoint_minutes`", "nan", "minutes"]),
            ("network.active_inputs=inf", ["`network.active_inputs`", "inf", "columns"]),
            ("network.width=1000000000", ["`network.width`", "1000000000", "1 to 1024"]),
            ("replay.batsch=3", ["`replay.batsch`", "no such key", "did you mean `replay.batch`?"]),
            ("learning_rate=3", ["`learning_rate`", "no such key", "`optimiser.learning_rate`?"]),
            ("replay.batch=many", ["`replay.batch`", "`many`", "a whole number"]),
        ] {
            let error = replaced(&records::Config::default(), assignment).unwrap_err().to_string();
            for part in parts {
                assert!(error.contains(part), "{assignment}: no `{part}` in {error}");
            }
        }
    }

    #[test]
    fn files_are_refused_by_line_and_key() {
        for (text, parts) in [
            ("[replay]\n\nbatch = \"a\"\n", ["line 3", "`replay.batch`", "a whole number"]),
            ("[run]\nsteps = 5\n[replay]\nbatsch = 3\n", ["line 4", "`replay.batsch`", "mean"]),
            ("replay.batch = 0\n", ["line 1", "`replay.batch`", "from 1"]),
            ("[network]\nsubtask = mask\n", ["line 2", "subtask = mask", "quoted"]),
        ] {
            let error = from_toml::<records::Config>(text).unwrap_err().to_string();
            for part in parts {
                assert!(error.contains(part), "{text}: no `{part}` in {error}");
            }
        }
    }
}
