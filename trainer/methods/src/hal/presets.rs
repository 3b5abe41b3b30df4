//! The methods by their names, and their presets.

use sortie_envs::{Spec, View};
use sortie_learn::configuration::OptimiserConfig;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

use super::config::{Config, KEYS, MetaConfig};
use super::method::Hal;
use crate::options::Mask;
use crate::pictures::Body;

/// HAL: affordances are learned.
pub const HAL: MethodEntry = MethodEntry {
    name: "hal",
    about: "An agent that learns which milestones it can reach, which to go for, and how (HAL, dissertation chapter 6)",
    keys: |_| KEYS,
    presets: &[
        Preset { name: "fast", setup: || fast(Mask::Learned) },
        Preset { name: "paper", setup: || paper(Mask::Learned) },
    ],
    flags: &[],
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

/// HAL that is told the truth.
pub const HAL_ORACLE: MethodEntry = MethodEntry {
    name: "hal-oracle",
    about: "The same agent, told which milestones it can reach (oracle mask)",
    presets: &[
        Preset { name: "fast", setup: || fast(Mask::Oracle) },
        Preset { name: "paper", setup: || paper(Mask::Oracle) },
    ],
    ..HAL
};

/// Two levels without a mask.
pub const H_DQN: MethodEntry = MethodEntry {
    name: "h-dqn",
    about: "The same agent, which may go for any milestone at any time (H-Rainbow with HER)",
    presets: &[
        Preset { name: "fast", setup: || fast(Mask::None) },
        Preset { name: "paper", setup: || paper(Mask::None) },
    ],
    ..HAL
};

fn fast(mask: Mask) -> Setup {
    let mut config = Config::default();
    config.affordances.mask = mask;
    if mask == Mask::None {
        // What did best without a mask; with one an option that gains nothing has to cost more.
        config.meta = MetaConfig { options: 10, discount: 0.98, ..config.meta };
    }
    config.optimiser = OptimiserConfig { learning_rate_end: 1e-4, ..config.optimiser };
    let run = RunConfig {
        steps: 5_000_000,
        evaluate_every: 500_000,
        evaluate_episodes: 100,
        ..RunConfig::default()
    };
    Setup::of(256, run, &config)
}

/// The published learner of the iron task; its episodes are as long in training as where it is measured.
fn paper(mask: Mask) -> Setup {
    let mut config = Config::paper();
    config.affordances.mask = mask;
    let run = RunConfig {
        steps: 6_000_000,
        evaluate_every: 200_000,
        evaluate_episodes: 100,
        ..RunConfig::default()
    };
    let mut setup = Setup::of(4, run, &config);
    setup.environment.settings.insert("training_limit".to_owned(), 4_320_i64.into());
    setup
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    if !matches!(spec.view, View::Pictures(_)) {
        return Some("its agent sees a picture, this environment shows something else");
    }
    (!(1..=24).contains(&spec.milestones.len()))
        .then_some("it goes from milestone to milestone, of which this environment tells none")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let refused = |reason: String| Err(LearnError::Config(reason));
    if !config.network.width.is_multiple_of(8) {
        return refused(format!(
            "`network.width` is {}, must be a multiple of 8",
            config.network.width
        ));
    }
    if !config.network.embedding.is_multiple_of(8) {
        return refused(format!(
            "`network.embedding` is {}, must be a multiple of 8",
            config.network.embedding
        ));
    }
    let kernels_fit = config.network.crop >= Body::SIDE && !config.network.nearest;
    if config.network.body == Body::Convolution && !kernels_fit {
        return refused(format!(
            "`network.body=convolution` goes over a picture: set `network.nearest=false` and `network.crop` to at least {}",
            Body::SIDE
        ));
    }
    let kept = config.replay.capacity / opening.setup.environment.instances;
    if kept <= 2 * usize::from(config.returns.option_steps) {
        return refused(format!(
            "`replay.capacity` leaves {kept} steps for each instance, too few"
        ));
    }
    let crop = config.network.crop;
    let hal = Hal::new(config, opening).ok_or_else(|| {
        LearnError::Config(format!("`network.crop` is {crop}: the picture has no such middle"))
    })?;
    Ok(Box::new(hal))
}
