//! How the agents learn to act.

use serde::{Deserialize, Serialize};
use sortie_envs::Spec;

use super::require;
use crate::alma::agents::{Columns, Conditioning, UtilityShape};
use crate::alma::records::mixer::{MixerKind, MixerShape};
use sortie_learn::LearnError;

/// Sizes of the utility network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of embedding and attention. The dissertation has 128.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Width of the layer before the head.
    pub base: usize,
    /// Non-zero inputs that the initial weights of the first layer are sized for.
    ///
    /// PyTorch would take all columns, although rows are mostly zeros.
    pub active_inputs: f32,
    /// Whether the own row's embedding skips the attention. Not in the dissertation.
    pub skip: bool,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self { width: 64, heads: 4, base: 64, active_inputs: 8.0, skip: true }
    }
}

impl NetworkConfig {
    /// Refuses values that do not go together; `of` names the section.
    pub(crate) fn check(&self, of: &str) -> Result<(), LearnError> {
        require(
            self.width.is_multiple_of(self.heads),
            &format!("`{of}.width` must be a multiple of `{of}.heads`"),
        )
    }

    /// The network's shape for rows of so many columns, with so many outputs.
    pub fn shape(&self, input: usize, actions: usize) -> UtilityShape {
        UtilityShape {
            input,
            width: self.width,
            heads: self.heads,
            base: self.base,
            actions,
            skip: self.skip,
        }
    }
}

/// The agents' network: its sizes, and what it sees of the subtasks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AgentNetworkConfig {
    /// What agents see of the subtasks: `mask`, `input` or `none`.
    pub subtask: Conditioning,
    /// Width of embedding and attention. The dissertation has 128.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Width of the layer before the head.
    pub base: usize,
    /// Non-zero inputs that the initial weights of the first layer are sized for.
    pub active_inputs: f32,
    /// Whether an agent's own embedding skips the attention. Not in the dissertation.
    pub skip: bool,
}

impl Default for AgentNetworkConfig {
    fn default() -> Self {
        let NetworkConfig { width, heads, base, active_inputs, skip } = NetworkConfig::default();
        Self { subtask: Conditioning::Mask, width, heads, base, active_inputs, skip }
    }
}

impl AgentNetworkConfig {
    /// The sizes alone.
    pub(super) fn sizes(&self) -> NetworkConfig {
        let Self { width, heads, base, active_inputs, skip, .. } = *self;
        NetworkConfig { width, heads, base, active_inputs, skip }
    }

    /// The network's shape in an environment.
    pub fn shape(&self, spec: &Spec) -> UtilityShape {
        let marks = self.subtask.task_columns(spec.shape.tasks);
        self.sizes().shape(Columns::of(&spec.shape).unmarked() + marks, spec.shape.actions)
    }
}

/// How the utilities of a team become its value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MixerConfig {
    /// `sum` (VDN), `linear` or `qmix`.
    pub kind: MixerKind,
    /// Width of embedding and attention of the hypernetwork that `linear` and `qmix` have.
    pub width: usize,
    /// Its attention heads.
    pub heads: usize,
    /// Width between the two layers of `qmix`.
    pub mixing: usize,
    /// Factor on the rewards under `qmix`, whose layers shrink values at first.
    pub reward_scale: f32,
}

impl Default for MixerConfig {
    fn default() -> Self {
        Self { kind: MixerKind::Sum, width: 64, heads: 4, mixing: 32, reward_scale: 0.2 }
    }
}

impl MixerConfig {
    /// The mixer's shape for entities of so many input columns.
    pub fn shape(&self, input: usize) -> MixerShape {
        let Self { kind, width, heads, mixing, .. } = *self;
        MixerShape { kind, input, width, heads, mixing }
    }

    /// What rewards are multiplied by.
    pub fn reward_factor(&self) -> f32 {
        if self.kind == MixerKind::Qmix { self.reward_scale } else { 1.0 }
    }

    pub(crate) fn check(&self) -> Result<(), LearnError> {
        require(
            self.width.is_multiple_of(self.heads),
            "`mixer.width` must be a multiple of `mixer.heads`",
        )
    }
}

/// How rewards become targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReturnsConfig {
    /// Steps before a target bootstraps.
    pub steps: u32,
    /// Discount per step.
    pub discount: f32,
    /// Potential per cell between an agent and its building; 0 turns shaping off. Without subtasks
    /// the nearest open building counts.
    ///
    /// Not in the dissertation. It leaves the best policy as it is and learning takes half as long.
    pub shaping: f32,
}

impl Default for ReturnsConfig {
    fn default() -> Self {
        Self { steps: 3, discount: 0.97, shaping: 0.5 }
    }
}
