//! MA-Exp: coordinated exploration by intrinsic rewards (Iqbal and Sha 2019; dissertation chapter 4).
//!
//! A team shares one reward that it rarely sees. Each of several heads explores for something else, by how often agents
//! have been where; one explores for nothing and is deployed. What is known of the world is kept by places, and values
//! are what follows from it. Frozen policies are tried out while others go on learning, and the best is deployed.

mod learner;
mod method;
mod table;

use sortie_envs::Spec;
use sortie_learn::configuration::Range::{self, Number, OneOf, Positive, Whole};
use sortie_learn::configuration::SHARE;
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method, sections};

use crate::multi_explore::{self, MultiExplore, is_networks};
use table::{ACTIONS, HEADS};

pub use crate::multi_explore as networks;
pub use crate::novelty::{Columns, Counts, Intrinsic, Place, Types, novelty};
pub use learner::{Audition, Deed, Learner, Rules, Shares};
pub use method::{MaExp, Selector};
pub use table::{Lanes, Outcome, Row, Table, Terms, Version, Way, Worth};

const VALUE: Range = Number(-1e6, 1e6);
const STEPS: Range = Whole(1, 1_000_000_000);

sections! {
    /// Heads, values and exploration; the default is the preset `fast`.
    Config, KEYS;

    /// What is explored for: a policy for each type of intrinsic reward, and one without, which is deployed.
    heads: HeadsConfig {
        /// Types of intrinsic rewards: one, none, or the five that the dissertation chooses among.
        intrinsic: Types = Types::Multi, OneOf(Types::WORDS);
        /// Chance that an episode is played by any head, whatever it returns; otherwise those that return much are
        /// likelier.
        any: f64 = 0.5, SHARE, "chance";
        /// Discounted return by which a head has to be better to be chosen e times as often.
        temperature: f64 = 1.0, Positive(1e6), "reward";
        /// When only the head without intrinsic rewards acts from.
        until: f64 = 0.7, SHARE, "share of the run";
    }

    /// What places and actions are worth.
    values: ValuesConfig {
        /// Discount of the team's rewards.
        discount: f32 = 0.99, SHARE, "per step";
        /// Discount of intrinsic rewards.
        intrinsic_discount: f32 = 0.95, SHARE, "per step";
        /// What an action is worth in the team's rewards until it is tried. -10 is finding nothing for ever; 0 is so
        /// hopeful that agents explore without any intrinsic reward.
        start: f32 = -10.0, VALUE, "reward";
        /// What an action is worth in intrinsic rewards until it is tried.
        intrinsic_start: f32 = 5.0, VALUE, "novelty";
        /// What intrinsic values count in the choice of actions.
        intrinsic_weight: f32 = 2.0, Number(0.0, 1e6), "reward per novelty";
        /// Tries of an action that count in what is known of it: partners change.
        memory: f32 = 100.0, Number(1.0, 1e9), "tries";
        /// Steps of an instance after which what it lived through is backed up, the last step first.
        segment: usize = 32, STEPS, "steps";
        /// Steps after which all that is known is backed up.
        sweep_every: u64 = 1_200, STEPS, "environment steps";
    }

    /// How actions are tried out.
    exploration: ExplorationConfig {
        /// Chance of a random action.
        epsilon: f32 = 0.1, SHARE, "chance";
        /// Chance of a random action once the head without intrinsic rewards acts alone.
        last_epsilon: f32 = 0.05, SHARE, "chance";
    }

    /// Frozen policies are tried out one after the other once the head without intrinsic rewards acts alone; the one
    /// that returns most is deployed.
    audition: AuditionConfig {
        /// Instances that play them; the others go on learning. 0: what is known at the end is deployed.
        instances: usize = 2, Whole(0, 4096), "instances";
        /// Episodes of each.
        episodes: u32 = 20, Whole(1, 1_000_000), "episodes";
    }
}

impl Config {
    /// How a team learns.
    pub fn rules(&self) -> Rules {
        let heads = self.heads.intrinsic.heads();
        let mut weights = [0.0; HEADS];
        weights[..heads.len() - 1].fill(self.values.intrinsic_weight);
        let ValuesConfig { discount, intrinsic_discount, memory, .. } = self.values;
        Rules { heads, weights, discounts: [discount, intrinsic_discount], memory }
    }
}

/// MA-Exp: several ways to explore together, and a choice between them.
pub const MA_EXP: MethodEntry = MethodEntry {
    name: "ma-exp",
    about: "Coordinated exploration by intrinsic rewards of several types (MA-Exp, dissertation chapter 4)",
    keys: |own| if is_networks(own) { multi_explore::KEYS } else { KEYS },
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: paper }],
    flags: &[],
    compared_with: None,
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
    Setup::of(12, run, &multi_explore::Config::default())
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
        return Ok(Box::new(MultiExplore::new(opening.setup.own()?, opening)));
    }
    let config: Config = opening.setup.own()?;
    Ok(Box::new(MaExp::new(config, opening)))
}
