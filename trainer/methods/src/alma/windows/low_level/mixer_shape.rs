//! Sizes and switches of a mixer.

use serde::{Deserialize, Serialize};

use super::hypernetwork::{HypernetworkShape, Mode};

/// How mixing weights are kept from being negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Nonnegative {
    /// A softmax over the mixing width.
    #[default]
    Softmax,
    /// Absolute values.
    Absolute,
}

/// Sizes and switches of a mixer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// Sizes of each of the hypernetworks.
    pub hypernetwork: HypernetworkShape,
    /// Agents A that means are over, absent ones included.
    pub slots: usize,
    /// Pairs of the PopArt head: one that all subtasks share, or one for each.
    pub outputs: usize,
    /// How weights are kept from being negative.
    pub nonnegative: Nonnegative,
    /// Whether `b1` and `V` go through absolute values.
    pub bias_nonnegative: bool,
}

/// The names of the hypernetworks and what they give, in the order of the parameters.
pub const HYPERNETWORKS: [(&str, Mode); 4] =
    [("w1", Mode::Matrix), ("b1", Mode::Vector), ("w2", Mode::Vector), ("v", Mode::Scalar)];

impl MixerShape {
    /// Number of parameters: four hypernetworks, then the head's weights and its biases.
    pub fn parameters(self) -> usize {
        4 * self.hypernetwork.parameters() + 2 * self.outputs
    }

    pub(super) fn hypernetworks<'a>(
        self,
        parameters: &'a [f32],
    ) -> impl Iterator<Item = &'a [f32]> + 'a {
        parameters.chunks_exact(self.hypernetwork.parameters()).take(HYPERNETWORKS.len())
    }
}
