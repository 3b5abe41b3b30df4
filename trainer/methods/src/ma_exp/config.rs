//! What a run of MA-Exp leaves open.

use sortie_learn::configuration::Range::{self, Number, OneOf, Positive, Whole};
use sortie_learn::configuration::SHARE;
use sortie_learn::sections;

use super::learner::Rules;
use super::table::HEADS;
use crate::novelty::intrinsic::Types;

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
