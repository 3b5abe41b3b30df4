//! What a run of value factorisation leaves open.

use serde::{Deserialize, Serialize};
use sortie_envs::{Shape, Spec};
use sortie_learn::configuration::{ExplorationConfig, OptimiserConfig};

use super::agent::AgentShape;
use super::mixer::{Hypernetworks, MixerKind, MixerShape};
use super::partition::Partitions;
use super::temporal_difference::NetworkShape;

/// Sizes, chances and rates; the default is the preset `fast` of A-QMIX.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The agents' network and the hypernetwork of the mixer.
    pub network: NetworkConfig,
    /// How utilities become the team's value.
    pub mixer: MixerConfig,
    /// What agents imagine.
    pub imagination: ImaginationConfig,
    /// How rewards become targets.
    pub returns: ReturnsConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How much the agents try out.
    pub exploration: ExplorationConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
    /// What follows the gradient, and the weights.
    #[serde(default)]
    pub update: UpdateConfig,
}

/// The agents' network and the hypernetwork of the mixer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of embedding and attention: 16, 32, 64 or 128.
    pub width: usize,
    /// Non-zero inputs that the first weights are sized for; 0: all columns.
    pub active_inputs: usize,
    /// Whether an agent's own embedding reaches the layer before the head.
    pub skip: bool,
    /// Width of what agents remember, a gated recurrent unit; 0: nothing.
    #[serde(default)]
    pub memory: usize,
}

/// How utilities become the team's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MixerConfig {
    /// Which mixer.
    pub kind: MixerKind,
    /// Who makes its numbers.
    #[serde(default)]
    pub hypernetworks: Hypernetworks,
    /// Width between the layers of QMIX.
    pub mixing: usize,
}

/// What agents imagine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImaginationConfig {
    /// Where the partitions come from.
    pub partitions: Partitions,
    /// The share of the loss that is about imagined values.
    pub share: f32,
}

/// How rewards become targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReturnsConfig {
    /// Steps of reward before a value is looked up.
    pub steps: usize,
    /// Discount per step.
    pub discount: f32,
}

/// What is kept and how much of it an update sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    /// What is drawn.
    #[serde(default)]
    pub unit: Unit,
    /// States, or episodes, that are kept, of all instances.
    pub capacity: usize,
    /// States, or episodes, of an update.
    pub batch: usize,
    /// Environment steps for each update; 0: an update for each episode that ends.
    pub steps_per_update: u64,
}

/// What is kept, and drawn for an update.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Unit {
    /// States, each with what followed it.
    #[default]
    Steps,
    /// Whole episodes.
    Episodes,
}

/// What follows the gradient, and the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UpdateConfig {
    /// How weights follow the gradient.
    pub rule: Rule,
    /// Updates from one move of the target network to the next.
    pub target_every: u64,
}

/// How weights follow the gradient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// By its running mean, scaled by the root of its running square.
    #[default]
    Adam,
    /// By itself, scaled by the root of its running square.
    RmsProp,
}

impl Default for UpdateConfig {
    fn default() -> Self {
        Self { rule: Rule::Adam, target_every: 1 }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: NetworkConfig { width: 32, active_inputs: 3, skip: true, memory: 0 },
            mixer: MixerConfig {
                kind: MixerKind::Linear,
                hypernetworks: Hypernetworks::Shared,
                mixing: 32,
            },
            imagination: ImaginationConfig { partitions: Partitions::None, share: 0.5 },
            returns: ReturnsConfig { steps: 3, discount: 0.9 },
            replay: ReplayConfig {
                unit: Unit::Steps,
                capacity: 200_000,
                batch: 256,
                steps_per_update: 16,
            },
            exploration: ExplorationConfig { steps: 5_000, ..ExplorationConfig::default() },
            optimiser: OptimiserConfig {
                learning_rate: 3e-3,
                decay_from: 0.6,
                average_rate: 0.001,
                ..OptimiserConfig::default()
            },
            update: UpdateConfig::default(),
        }
    }
}

impl Config {
    /// The preset `paper` of A-QMIX: the dissertation's, as its chapter 5 learns Group Matching.
    pub fn paper() -> Self {
        Self {
            network: NetworkConfig { width: 64, active_inputs: 0, skip: false, memory: 0 },
            mixer: MixerConfig {
                kind: MixerKind::Linear,
                hypernetworks: Hypernetworks::Separate,
                mixing: 32,
            },
            imagination: ImaginationConfig { partitions: Partitions::None, share: 0.5 },
            returns: ReturnsConfig { steps: 1, discount: 0.99 },
            replay: ReplayConfig {
                unit: Unit::Episodes,
                capacity: 2_000,
                batch: 32,
                steps_per_update: 0,
            },
            exploration: ExplorationConfig {
                steps: 5_000,
                spread: vec![1.0],
                ..ExplorationConfig::default()
            },
            optimiser: OptimiserConfig {
                learning_rate: 5e-4,
                learning_rate_end: 5e-4,
                decay_from: 1.0,
                clip: 10.0,
                target_rate: 1.0,
                average_rate: 1.0,
                ..OptimiserConfig::default()
            },
            update: UpdateConfig { rule: Rule::RmsProp, target_every: 200 },
        }
    }

    /// The networks for an environment.
    pub fn shape(&self, spec: &Spec) -> NetworkShape {
        let NetworkConfig { width, active_inputs, skip, memory } = self.network;
        let MixerConfig { kind, hypernetworks, mixing } = self.mixer;
        let Shape { features: input, actions, .. } = spec.shape;
        let active_inputs = if active_inputs == 0 { input } else { active_inputs };
        NetworkShape {
            agent: AgentShape { input, active_inputs, width, actions, skip, memory },
            mixer: MixerShape { kind, hypernetworks, input, active_inputs, width, mixing },
        }
    }
}
