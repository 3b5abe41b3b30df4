//! The methods by their names, and their presets.

use sortie_envs::{Spec, View};
use sortie_learn::networks::MixerKind;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{Flag, MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};
use sortie_nn::layers::split_attention::WIDTHS;

use super::{Config, KEYS, Partitions, ReplayConfig, Unit, ValueFactorisation};

/// What a solved episode returns by rewards as `fast` scales them where actions are aimed.
const SOLVED: f32 = 20.0;

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
    compared_with: None,
    in_proportion: &[],
    suit,
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

/// What `fast` is in an environment. How utilities are mixed, and what is imagined, stays the method's own.
fn suit(preset: &str, setup: &mut Setup, spec: &Spec) {
    let Ok(Config { mixer, imagination, .. }) = setup.own() else { return };
    if preset != "fast" || spec.targets.is_empty() {
        return;
    }
    let mut config = Config { imagination, ..Config::aimed() };
    config.mixer.kind = mixer.kind;
    // First values are some tenths; what is earned must not be small against them.
    if spec.solved_return > 0.0 {
        config.returns.scale = SOLVED / spec.solved_return;
    }
    let run = RunConfig { steps: 850_000, evaluate_every: 50_000, ..setup.run.clone() };
    let Setup { method, environment, .. } = setup.clone();
    *setup = Setup { method, environment, ..Setup::of(0, run, &config) };
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    (spec.view != View::Entities)
        .then_some("its agents look at entities, of which this environment shows none")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let spec = opening.environment.spec();
    let ReplayConfig { unit, capacity, batch, steps_per_update, .. } = config.replay;
    let (width, kept) = (config.network.width, capacity / opening.setup.environment.instances);
    let reason = match unit {
        _ if !WIDTHS.contains(&width) => {
            format!("`network.width` is {width}, must be one of {WIDTHS:?}")
        }
        Unit::Steps if kept <= 4 * config.returns.steps => {
            format!("`replay.capacity` leaves {kept} states for each instance, too few")
        }
        Unit::Steps if steps_per_update == 0 => {
            "`replay.steps_per_update` is 0, an update for each episode, which `replay.unit=episodes` counts".to_owned()
        }
        Unit::Steps if config.network.memory > 0 => {
            "`network.memory` is learned through whole episodes, which `replay.unit=episodes` keeps".to_owned()
        }
        Unit::Episodes if capacity < batch => {
            format!("`replay.capacity` is {capacity} episodes, an update draws {batch} different ones")
        }
        _ => return Ok(Box::new(ValueFactorisation::new(config, opening))),
    };
    let method = &opening.setup.method;
    Err(LearnError::Config(format!("`{method}` in `{}`: {reason}", spec.name)))
}

#[cfg(test)]
mod tests {
    use sortie_envs::Split;
    use sortie_learn::networks::WeightsSum;

    use super::*;

    /// A preset as it is in an environment, and read back from a file of it.
    fn suited(entry: MethodEntry, preset: &str, set: &str) -> Setup {
        let world = sortie_envs::open(set, Split::Train, 1, &Default::default()).unwrap();
        let mut setup = entry.preset(preset).unwrap();
        setup.environment.name = set.to_owned();
        suit(preset, &mut setup, world.spec());
        assert_eq!(setup.environment.name, set);
        assert_eq!(entry.read(&entry.explained(&setup).unwrap()).unwrap(), setup);
        setup
    }

    #[test]
    fn fast_suits_actions_that_are_aimed() {
        for entry in [QMIX, VDN, REFIL] {
            let usual = suited(entry, "fast", "group-matching/4x3x2");
            let battles = suited(entry, "fast", "smax/2s3z");
            let unlike = |setup: &Setup| setup.own::<Config>().unwrap();
            let [own, aimed] = [&usual, &battles].map(unlike);
            let plain = entry.preset("fast").unwrap();
            assert_eq!((own.clone(), usual.run), (unlike(&plain), plain.run));
            assert_eq!((aimed.mixer.kind, &aimed.imagination), (own.mixer.kind, &own.imagination));
            assert_eq!((aimed.network.width, aimed.returns.scale), (128, 10.0));
            assert_eq!(aimed.mixer.weights_sum, WeightsSum::Agents);
            assert_eq!((battles.run.steps, battles.environment.instances), (850_000, 16));
            let paper = suited(entry, "paper", "smax/2s3z");
            assert_eq!(
                (paper.own, paper.run.steps),
                (entry.preset("paper").unwrap().own, 2_000_000)
            );
        }
    }

    #[test]
    fn runs_of_before_had_their_rewards_as_they_were() {
        let text = QMIX.preset("fast").unwrap().to_toml().unwrap();
        let older = text.replace("scale = 1.0\n", "");
        assert_ne!(older, text);
        let read: Config = Setup::from_text("qmix", &older).unwrap().own().unwrap();
        assert_eq!(read, Config::default());
    }
}
