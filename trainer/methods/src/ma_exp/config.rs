//! What a run of MA-Exp leaves open.

use serde::{Deserialize, Serialize};

use super::intrinsic::Intrinsic;
use super::learner::Rules;
use super::table::HEADS;

/// Heads, values and exploration; the default is the preset `fast`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What is explored for.
    pub heads: HeadsConfig,
    /// What places and actions are worth.
    pub values: ValuesConfig,
    /// How actions are tried out.
    pub exploration: ExplorationConfig,
    /// How frozen policies are tried out.
    pub audition: AuditionConfig,
}

/// What is explored for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadsConfig {
    /// Types of intrinsic rewards, a head for each; one more is without.
    pub intrinsic: Types,
    /// Chance that an episode is played by any head, whatever it returns.
    pub any: f64,
    /// Returns by which a head has to be better to be chosen e times as often.
    pub temperature: f64,
    /// Share of the run after which only the head without intrinsic rewards acts.
    pub until: f64,
}

/// Types of intrinsic rewards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Types {
    /// The five that the dissertation chooses among.
    Multi,
    /// None.
    None,
    /// One.
    #[serde(untagged)]
    One(Intrinsic),
}

/// What places and actions are worth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValuesConfig {
    /// Discount of the team's rewards per step.
    pub discount: f32,
    /// Discount of intrinsic rewards per step.
    pub intrinsic_discount: f32,
    /// What an action is worth in the team's rewards until it is tried.
    pub start: f32,
    /// What an action is worth in intrinsic rewards until it is tried.
    pub intrinsic_start: f32,
    /// What intrinsic values count in the choice of actions.
    pub intrinsic_weight: f32,
    /// Tries of an action that count in what is known of it.
    pub memory: f32,
    /// Steps of an instance after which what it lived through is backed up.
    pub segment: usize,
    /// Environment steps after which everything is backed up.
    pub sweep_every: u64,
}

/// How actions are tried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExplorationConfig {
    /// Chance of a random action.
    pub epsilon: f32,
    /// The same once the last head acts alone.
    pub last_epsilon: f32,
}

/// How frozen policies are tried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuditionConfig {
    /// Instances that play them once the last head acts alone.
    pub instances: usize,
    /// Episodes of each.
    pub episodes: u32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            heads: HeadsConfig { intrinsic: Types::Multi, any: 0.5, temperature: 1.0, until: 0.7 },
            values: ValuesConfig {
                discount: 0.99,
                intrinsic_discount: 0.95,
                start: -10.0,
                intrinsic_start: 5.0,
                intrinsic_weight: 2.0,
                memory: 100.0,
                segment: 32,
                sweep_every: 1_200,
            },
            exploration: ExplorationConfig { epsilon: 0.1, last_epsilon: 0.05 },
            audition: AuditionConfig { instances: 2, episodes: 20 },
        }
    }
}

impl Types {
    /// The types of the heads, and at last the one without.
    fn heads(self) -> Vec<Option<Intrinsic>> {
        let types = match self {
            Self::Multi => Intrinsic::CHOSEN.to_vec(),
            Self::None => Vec::new(),
            Self::One(intrinsic) => vec![intrinsic],
        };
        types.into_iter().map(Some).chain([None]).collect()
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
