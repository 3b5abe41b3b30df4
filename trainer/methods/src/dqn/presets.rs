//! The method by its name, and its presets.

use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

use super::config::{Config, KEYS};
use super::method::Dqn;
use crate::options::{misfit, presets};

/// An agent without goals.
pub const DQN: MethodEntry = MethodEntry {
    name: "dqn",
    about: "An agent without goals that is paid for the milestones it reaches (Rainbow in dissertation chapter 6)",
    keys: |_| KEYS,
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: paper }],
    flags: &[],
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

fn fast() -> Setup {
    presets::fast(&Config { optimiser: presets::fast_optimiser(), ..Config::default() })
}

fn paper() -> Setup {
    presets::paper(&Config::paper())
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    Ok(Box::new(Dqn::new(opening.setup.own()?, opening)?))
}
