//! What a run of value factorisation leaves open.

use serde::{Deserialize, Serialize};
use sortie_envs::{Shape, Spec};
use sortie_learn::configuration::{ExplorationConfig, OptimiserConfig};

use super::agent::AgentShape;
use super::mixer::{MixerKind, MixerShape};
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
}

/// The agents' network and the hypernetwork of the mixer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of embedding and attention: 16, 32, 64 or 128.
    pub width: usize,
    /// Non-zero inputs that the first weights are sized for.
    pub active_inputs: usize,
    /// Whether an agent's own embedding reaches the layer before the head.
    pub skip: bool,
}

/// How utilities become the team's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MixerConfig {
    /// Which mixer.
    pub kind: MixerKind,
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
    /// States that are kept, of all instances.
    pub capacity: usize,
    /// Records of an update.
    pub batch: usize,
    /// Environment steps for each update.
    pub steps_per_update: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: NetworkConfig { width: 32, active_inputs: 3, skip: true },
            mixer: MixerConfig { kind: MixerKind::Linear, mixing: 32 },
            imagination: ImaginationConfig { partitions: Partitions::None, share: 0.5 },
            returns: ReturnsConfig { steps: 3, discount: 0.9 },
            replay: ReplayConfig { capacity: 200_000, batch: 256, steps_per_update: 16 },
            exploration: ExplorationConfig { steps: 5_000, ..ExplorationConfig::default() },
            optimiser: OptimiserConfig {
                learning_rate: 3e-3,
                decay_from: 0.6,
                average_rate: 0.001,
                ..OptimiserConfig::default()
            },
        }
    }
}

impl Config {
    /// The networks for an environment.
    pub fn shape(&self, spec: &Spec) -> NetworkShape {
        let NetworkConfig { width, active_inputs, skip } = self.network;
        let MixerConfig { kind, mixing } = self.mixer;
        let Shape { features: input, actions, .. } = spec.shape;
        NetworkShape {
            agent: AgentShape { input, active_inputs, width, actions, skip },
            mixer: MixerShape { kind, input, active_inputs, width, mixing },
        }
    }
}
