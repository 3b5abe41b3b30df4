//! Sizes, switches and rates of the low level.

use serde::{Deserialize, Serialize};

use super::super::batch::WindowShape;
use super::hypernetwork::HypernetworkShape;
use super::mixer_shape::{MixerShape, Nonnegative};
use crate::alma::agents::{Conditioning, UtilityShape};
use crate::alma::coach::CoachShape;
use crate::alma::records::config::ReturnsConfig;

/// When the PopArt head is rescaled to new statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PopArtOrder {
    /// Before values are computed, so that they and the targets are in the same units.
    #[default]
    RescaleFirst,
    /// Between the forward and the backward pass, as the public code does.
    Reference,
}

/// How the low level learns. The default is that of the dissertation's experiments with SaveTheCity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LowLevelConfig {
    /// What agents and mixer see of the subtasks.
    pub conditioning: Conditioning,
    /// Spare subtask marks, shuffled in with the others.
    pub extra_tasks: usize,
    /// Width of the agents' embedding and attention.
    pub width: usize,
    /// Heads of the agents' attention, a divisor of the width.
    pub heads: usize,
    /// Width of the layer before the agents' head.
    pub base: usize,
    /// Inputs of an entity that are not zero, by which the embedding's first weights are drawn; 0 counts
    /// them all, as PyTorch does.
    pub active_inputs: f32,
    /// Whether an agent's own embedding skips the attention. Not in the dissertation.
    pub skip: bool,
    /// Whether the agents have a memory: a gated recurrent unit before the head, emptied when an episode
    /// ends. It begins empty in every window.
    pub recurrent: bool,
    /// Width of the hypernetworks' embedding and attention.
    pub hypernetwork_width: usize,
    /// Heads of the hypernetworks' attention, a divisor of the width.
    pub hypernetwork_heads: usize,
    /// Width between the mixer's two layers.
    pub mixing: usize,
    /// How mixing weights are kept from being negative.
    pub nonnegative: Nonnegative,
    /// Whether mixing biases go through absolute values, as in the public code of ALMA.
    pub bias_nonnegative: bool,
    /// Whether each subtask has a PopArt head of its own, as in the public code.
    pub popart_per_task: bool,
    /// When the PopArt head is rescaled.
    pub popart_order: PopArtOrder,
    /// Whether the agents stay as they are: only the allocator learns.
    pub frozen: bool,
    /// Whether actions that apply to a subtask are available to the agents allocated to it only.
    pub task_availability: bool,
    /// How rewards become targets.
    pub returns: ReturnsConfig,
    /// Learning rate of RMSprop.
    pub learning_rate: f32,
    /// Largest norm of the gradient.
    pub clip: f32,
}

impl Default for LowLevelConfig {
    fn default() -> Self {
        Self {
            conditioning: Conditioning::Mask,
            extra_tasks: 0,
            width: 128,
            heads: 4,
            base: 64,
            active_inputs: 0.0,
            skip: false,
            recurrent: false,
            hypernetwork_width: 128,
            hypernetwork_heads: 4,
            mixing: 32,
            nonnegative: Nonnegative::Softmax,
            bias_nonnegative: false,
            popart_per_task: false,
            popart_order: PopArtOrder::RescaleFirst,
            frozen: false,
            task_availability: false,
            returns: ReturnsConfig { steps: 1, discount: 0.99, shaping: 0.0 },
            learning_rate: 5e-4,
            clip: 10.0,
        }
    }
}

impl LowLevelConfig {
    /// The sizes of the agents' network in an environment of these sizes.
    pub fn shape(&self, sizes: WindowShape) -> UtilityShape {
        let marks = self.conditioning.task_columns(sizes.tasks + self.extra_tasks);
        UtilityShape {
            input: sizes.features + sizes.actions + marks,
            width: self.width,
            heads: self.heads,
            base: self.base,
            actions: sizes.actions,
            skip: self.skip,
        }
    }

    /// The sizes of a coach in an environment of these sizes: as wide as its players.
    pub fn coach(&self, sizes: WindowShape) -> CoachShape {
        CoachShape {
            features: sizes.features,
            marks: sizes.tasks + self.extra_tasks,
            width: self.width,
            heads: self.heads,
            strategy: self.base,
        }
    }

    /// The sizes of the mixer in an environment of these sizes.
    pub fn mixer(&self, sizes: WindowShape) -> MixerShape {
        let tasks = if self.conditioning.has_subtasks() { sizes.tasks } else { 1 };
        let marks = self.conditioning.task_columns(sizes.tasks);
        MixerShape {
            hypernetwork: HypernetworkShape {
                input: sizes.features + sizes.actions + marks,
                width: self.hypernetwork_width,
                heads: self.hypernetwork_heads,
                mixing: self.mixing,
            },
            slots: sizes.agents,
            outputs: if self.popart_per_task { tasks } else { 1 },
            nonnegative: self.nonnegative,
            bias_nonnegative: self.bias_nonnegative,
        }
    }
}
