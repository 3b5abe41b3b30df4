//! What a run of value factorisation leaves open.

use serde::{Deserialize, Serialize};
use sortie_envs::{Shape, Spec};

use super::agent::AgentShape;
use super::mixer::{MixerKind, MixerShape};
use super::partition::Partitions;
use super::temporal_difference::NetworkShape;

/// Sizes, chances and rates; the default is the preset `fast`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Width of embeddings and attention, of agents and hypernetwork.
    pub width: usize,
    /// Whether an agent's own embedding reaches the layer before the head.
    pub skip: bool,
    /// How utilities become the team's value.
    pub mixer: MixerKind,
    /// Width between the layers of QMIX.
    pub mixing: usize,
    /// What is imagined.
    pub partitions: Partitions,
    /// The share of the loss that is about imagined values.
    pub imagined: f32,
    /// Discount per step.
    pub discount: f32,
    /// Steps of reward before a value is looked up.
    pub steps: usize,
    /// Records of an update.
    pub batch: usize,
    /// Environment steps for each update.
    pub steps_per_update: u64,
    /// States that are kept, of all instances.
    pub capacity: usize,
    /// Step size of Adam at first.
    pub learning_rate: f32,
    /// The share of the run after which the step size falls in a line to nothing.
    pub constant: f32,
    /// Added to the denominator of Adam.
    pub epsilon: f32,
    /// The longest gradient.
    pub clip: f32,
    /// How far the target network follows after each update.
    pub target_rate: f32,
    /// How far the averaged weights, which are what is evaluated, follow after each update.
    pub average_rate: f32,
    /// Chance of a random action at first, and at last.
    pub exploration: [f32; 2],
    /// Environment steps between them.
    pub exploration_steps: u64,
    /// By what instances multiply that chance, one after the other and again.
    pub exploration_spread: Vec<f32>,
    /// Instances that are played at once.
    pub instances: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            width: 32,
            skip: true,
            mixer: MixerKind::Linear,
            mixing: 32,
            partitions: Partitions::None,
            imagined: 0.5,
            discount: 0.9,
            steps: 3,
            batch: 256,
            steps_per_update: 16,
            capacity: 200_000,
            learning_rate: 3e-3,
            constant: 0.6,
            epsilon: 1e-5,
            clip: 10.0,
            target_rate: 0.01,
            average_rate: 0.001,
            exploration: [1.0, 0.05],
            exploration_steps: 5_000,
            exploration_spread: vec![0.0, 0.2, 1.0, 2.0],
            instances: 16,
        }
    }
}

impl Config {
    /// The networks for an environment.
    pub fn shape(&self, spec: &Spec) -> NetworkShape {
        let Self { width, skip, mixer: kind, mixing, .. } = *self;
        let Shape { features: input, actions, .. } = spec.shape;
        let active_inputs = spec.row_entries.min(input);
        NetworkShape {
            agent: AgentShape { input, active_inputs, width, actions, skip },
            mixer: MixerShape { kind, input, active_inputs, width, mixing },
        }
    }
}
