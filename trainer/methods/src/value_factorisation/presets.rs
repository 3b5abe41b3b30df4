//! The methods by their names, and their presets.

use sortie_envs::{Spec, View};
use sortie_learn::run::RunConfig;
use sortie_learn::session::{Flag, MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

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
    keys: |_| KEYS,
    presets: &[
        Preset { name: "fast", setup: || fast(plain) },
        Preset { name: "paper", setup: || paper(plain) },
    ],
    flags: &[Flag { name: "--mixer", assignments: &["mixer.kind={}"] }],
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
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
    Setup::of(instances, run, &config)
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    (spec.view != View::Entities)
        .then_some("its agents look at entities, of which this environment shows none")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let spec = opening.environment.spec();
    let refused = |reason: String| {
        Err(LearnError::Config(format!("`{}` in `{}`: {reason}", opening.setup.method, spec.name)))
    };
    if !WIDTHS.contains(&config.network.width) {
        return refused(format!(
            "`network.width` is {}, must be one of {WIDTHS:?}",
            config.network.width
        ));
    }
    let ReplayConfig { unit, capacity, batch, steps_per_update } = config.replay;
    let kept = capacity / opening.setup.environment.instances;
    match unit {
        Unit::Steps if kept <= 4 * config.returns.steps => {
            return refused(format!(
                "`replay.capacity` leaves {kept} states for each instance, too few"
            ));
        }
        Unit::Steps if steps_per_update == 0 => {
            return refused(
                "`replay.steps_per_update` is 0, an update for each episode, which `replay.unit=episodes` counts"
                    .to_owned(),
            );
        }
        Unit::Steps if config.network.memory > 0 => {
            return refused(
                "`network.memory` is learned through whole episodes, which `replay.unit=episodes` keeps"
                    .to_owned(),
            );
        }
        Unit::Episodes if capacity < batch => {
            return refused(format!(
                "`replay.capacity` is {capacity} episodes, an update draws {batch} different ones"
            ));
        }
        _ => {}
    }
    Ok(Box::new(ValueFactorisation::new(config, opening)))
}
