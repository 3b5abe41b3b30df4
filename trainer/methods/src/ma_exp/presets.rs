//! The method by its name, and its presets.

use sortie_envs::Spec;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method};

use super::config::{Config, KEYS};
use super::method::MaExp;
use super::table::ACTIONS;
use crate::multi_explore::{self, ALL_KEYS, LEARNER, MultiExplore, NETWORKS, is_networks};
use crate::novelty::places::Columns;

/// MA-Exp: several ways to explore together, and a choice between them.
pub const MA_EXP: MethodEntry = MethodEntry {
    name: "ma-exp",
    about: "Coordinated exploration by intrinsic rewards of several types (MA-Exp, dissertation chapter 4)",
    keys: |own| if is_networks(own) { ALL_KEYS } else { KEYS },
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: paper }],
    flags: &[],
    in_proportion: &[],
    suit,
    settle_older: |_| {},
    misfit,
    open,
};

fn fast() -> Setup {
    let run = RunConfig {
        steps: 300_000,
        evaluate_every: 100_000,
        evaluate_episodes: 200,
        ..RunConfig::default()
    };
    Setup::of(12, run, &Config::default())
}

fn paper() -> Setup {
    let run = RunConfig {
        steps: 1_000_000,
        evaluate_every: 100_000,
        evaluate_episodes: 200,
        ..RunConfig::default()
    };
    let mut setup = Setup::of(12, run, &multi_explore::Config::default());
    setup.own.insert(LEARNER.to_owned(), NETWORKS.into());
    setup
}

/// Tasks of several tiers, and larger teams, take longer.
fn suit(preset: &str, setup: &mut Setup, spec: &Spec) {
    let treasures = Columns::of(spec).map_or(0, |columns| columns.treasures());
    if preset == "fast" && (treasures > spec.shape.agents || spec.shape.agents > 2) {
        setup.run.steps = if treasures > spec.shape.agents { 1_000_000 } else { 600_000 };
    }
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    let fits = Columns::of(spec).is_some() && spec.shape.actions == ACTIONS;
    (!fits).then_some(
        "its agents count their visits to cells of a grid and remember what they found there, of which this environment shows nothing",
    )
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    if is_networks(&opening.setup.own) {
        let config = multi_explore::Config::of(opening.setup)?;
        return Ok(Box::new(MultiExplore::new(config, opening)));
    }
    let config: Config = opening.setup.own()?;
    Ok(Box::new(MaExp::new(config, opening)))
}
