//! The methods by their names, and their presets.

use sortie_envs::View;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{EnvironmentChoice, MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};
use toml::Table;

use super::config::{Config, ReplayConfig, Unit};
use super::keys::KEYS;
use super::method::ValueFactorisation;
use super::mixer::MixerKind;
use super::partition::Partitions;
use super::split_attention::WIDTHS;

/// A-QMIX: agents that look at entities, under a mixer that does.
pub const QMIX: MethodEntry = MethodEntry {
    name: "qmix",
    about: "Utilities of agents that attend to entities, mixed by what a hypernetwork sees (A-QMIX, dissertation chapter 5)",
    sections: KEYS,
    presets: &[
        Preset { name: "fast", setup: || fast(plain) },
        Preset { name: "paper", setup: || paper(plain) },
    ],
    open,
};

/// VDN: the utilities are added.
pub const VDN: MethodEntry = MethodEntry {
    name: "vdn",
    about: "The same agents, whose utilities are added (VDN)",
    presets: &[
        Preset { name: "fast", setup: || fast(add_up) },
        Preset { name: "paper", setup: || paper(add_up) },
    ],
    ..QMIX
};

/// REFIL: A-QMIX that learns from imagined groups besides.
pub const REFIL: MethodEntry = MethodEntry {
    name: "refil",
    about: "A-QMIX that learns besides from imagined groups, drawn at random (REFIL, dissertation chapter 5)",
    presets: &[
        Preset { name: "fast", setup: || fast(imagine) },
        Preset { name: "paper", setup: || paper(imagine) },
    ],
    ..QMIX
};

fn plain(_: &mut Config) {}

fn add_up(config: &mut Config) {
    config.mixer.kind = MixerKind::Sum;
}

fn imagine(config: &mut Config) {
    config.imagination.partitions = Partitions::Drawn;
}

fn fast(change: fn(&mut Config)) -> Setup {
    let run = RunConfig { steps: 100_000, evaluate_every: 10_000, ..RunConfig::default() };
    setup(16, run, Config::default(), change)
}

fn paper(change: fn(&mut Config)) -> Setup {
    let run = RunConfig {
        steps: 2_000_000,
        evaluate_every: 10_000,
        evaluate_episodes: 80,
        ..RunConfig::default()
    };
    setup(8, run, Config::paper(), change)
}

fn setup(instances: usize, run: RunConfig, mut config: Config, change: fn(&mut Config)) -> Setup {
    change(&mut config);
    Setup {
        environment: EnvironmentChoice { instances, ..EnvironmentChoice::default() },
        run,
        own: table(&config),
        ..Setup::default()
    }
}

/// The configuration as a file has it; through text, in which numbers have no more digits than they need.
fn table(config: &Config) -> Table {
    let text = toml::to_string(config).expect("sizes and rates are values of a file");
    text.parse().expect("what was written can be read")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let Opening { spec, .. } = opening;
    let misfit = |reason: String| {
        Err(LearnError::Config(format!("`{}` in `{}`: {reason}", opening.setup.method, spec.name)))
    };
    if spec.view != View::Entities {
        return misfit(
            "its agents look at entities, of which this environment shows none".to_owned(),
        );
    }
    if !WIDTHS.contains(&config.network.width) {
        return misfit(format!(
            "`network.width` is {}, must be one of {WIDTHS:?}",
            config.network.width
        ));
    }
    let ReplayConfig { unit, capacity, batch, steps_per_update } = config.replay;
    let kept = capacity / opening.setup.environment.instances;
    match unit {
        Unit::Steps if kept <= 4 * config.returns.steps => {
            return misfit(format!(
                "`replay.capacity` leaves {kept} states for each instance, too few"
            ));
        }
        Unit::Steps if steps_per_update == 0 => {
            return misfit(
                "`replay.steps_per_update` is 0, an update for each episode, which `replay.unit=episodes` counts"
                    .to_owned(),
            );
        }
        Unit::Steps if config.network.memory > 0 => {
            return misfit(
                "`network.memory` is learned through whole episodes, which `replay.unit=episodes` keeps"
                    .to_owned(),
            );
        }
        Unit::Episodes if capacity < batch => {
            return misfit(format!(
                "`replay.capacity` is {capacity} episodes, an update draws {batch} different ones"
            ));
        }
        _ => {}
    }
    Ok(Box::new(ValueFactorisation::new(config, opening)))
}
