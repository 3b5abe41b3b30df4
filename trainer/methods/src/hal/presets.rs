//! The methods by their names, and their presets.

use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

use super::config::{Config, KEYS, MetaConfig};
use super::method::Hal;
use crate::options::{Mask, misfit, presets};

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
    config.optimiser = presets::fast_optimiser();
    presets::fast(&config)
}

fn paper(mask: Mask) -> Setup {
    let mut config = Config::paper();
    config.affordances.mask = mask;
    presets::paper(&config)
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    Ok(Box::new(Hal::new(config, opening)?))
}
