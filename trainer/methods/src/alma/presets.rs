//! The methods by their names, and their presets.

use sortie_envs::Spec;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{Flag, MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

use super::config::{Config, keys, settle_older};
use super::records;
use super::records::{Records, STAND_INS};
use super::run::learned;
use super::windows::{self, WindowLearner};
use crate::alma::agents::Conditioning;
use crate::alma::teams::Allocation;

/// The methods of this module.
pub const METHODS: [MethodEntry; 3] = [ALMA, FLAT, COPA];

const MIXER: Flag = Flag { name: "--mixer", assignments: &["mixer.kind={}"] };

/// ALMA: agents act on the subtasks that an allocator gives them.
pub const ALMA: MethodEntry = MethodEntry {
    name: "alma",
    about: "Subtask-masked utilities under an allocation (ALMA, dissertation chapter 7)",
    keys,
    presets: &[
        Preset { name: "fast", setup: || fast(|_| {}) },
        Preset { name: "paper", setup: || paper(|_| {}) },
    ],
    flags: &[
        MIXER,
        Flag { name: "--no-mask", assignments: &["network.subtask=input"] },
        Flag { name: "--no-mask", assignments: &["low_level.conditioning=input"] },
        Flag { name: "--allocation", assignments: &["allocation.by={}"] },
        Flag {
            name: "--allocation",
            assignments: &[
                "allocation.learned=0",
                "allocation.coordinated=0",
                "allocation.heuristic=0",
                "allocation.random=0",
                "allocation.{}=1",
            ],
        },
    ],
    in_proportion: &["exploration.steps", "allocator.learns_from", "allocator.decides_from"],
    suit: |_, _, _| {},
    settle_older,
    misfit,
    open,
};

/// The same agents without subtasks.
pub const FLAT: MethodEntry = MethodEntry {
    name: "flat",
    about: "The same without subtasks: everybody sees everything and earns the whole team's reward",
    presets: &[
        Preset {
            name: "fast",
            setup: || fast(|config| config.network.subtask = Conditioning::None),
        },
        Preset {
            name: "paper",
            setup: || paper(|config| config.low_level.conditioning = Conditioning::None),
        },
    ],
    flags: &[MIXER],
    ..ALMA
};

/// COPA: flat agents whom a coach tells strategies; it learns from windows by either preset.
pub const COPA: MethodEntry = MethodEntry {
    name: "copa",
    about: "Flat agents and a coach that sees everything and tells each of them a strategy now and then",
    presets: &[
        Preset { name: "fast", setup: coached },
        Preset { name: "paper", setup: || paper(windows::Config::enable_coach) },
    ],
    flags: &[],
    ..ALMA
};

fn fast(change: fn(&mut records::Config)) -> Setup {
    let mut config = records::Config::default();
    change(&mut config);
    Setup::of(16, RunConfig::default(), &config)
}

fn paper(change: fn(&mut windows::Config)) -> Setup {
    let run = RunConfig { steps: 10_000_000, evaluate_episodes: 160, ..RunConfig::default() };
    let mut config = windows::Config::default();
    change(&mut config);
    Setup::of(8, run, &config)
}

/// Learned from windows too, under the conditions of the other methods' preset `fast`.
fn coached() -> Setup {
    let mut config = windows::Config::like_fast();
    config.enable_coach();
    Setup::of(8, RunConfig::default(), &config)
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    if spec.shape.tasks == 0 || !spec.rewards.tasks {
        return Some("it has no subtasks with rewards of their own");
    }
    let has = |name: &Allocation| spec.rules.iter().any(|rule| rule.name == name.name());
    (!STAND_INS.iter().all(has)).then_some(
        "it lacks a rule of allocation, `coordinated` or `heuristic`, that stands in at first",
    )
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let Opening { setup, environment, seed, threads } = *opening;
    let config = Config::of(setup)?;
    let (asked, found) = (&setup.method, config.method());
    if asked != found {
        let reason = format!("`{asked}` with these values is `{found}`: `sortie train {found}`");
        return Err(LearnError::Config(reason));
    }
    Ok(match config {
        Config::Records(config) => {
            let records = Records::new(&config, environment, seed, threads);
            Box::new(records.beginning_with(learned))
        }
        Config::Windows(config) => {
            let windows = WindowLearner::new(&config, environment.spec(), seed, threads);
            Box::new(windows.beginning_with(learned))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_envs::{Rewards, Rule, Shape};

    #[test]
    fn what_an_environment_lacks_is_said() {
        let mut spec = Spec {
            shape: Shape { agents: 2, entities: 4, tasks: 2, actions: 3, features: 2 },
            rewards: Rewards { tasks: true, agents: false },
            rules: &[
                Rule { name: "coordinated", about: "" },
                Rule { name: "heuristic", about: "" },
            ],
            ..Spec::default()
        };
        assert_eq!(misfit(&spec), None);
        spec.rules = &spec.rules[..1];
        assert!(misfit(&spec).is_some_and(|lack| lack.contains("`heuristic`")));
        spec.shape.tasks = 0;
        assert!(misfit(&spec).is_some_and(|lack| lack.contains("no subtasks")));
    }
}
