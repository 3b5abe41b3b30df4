//! The attention hypernetwork: numbers for each agent of a team from everything around it.
//!
//! Dissertation section 5.3.2 and the public code: embed, attend, project. No activation stands between
//! the attention's output projection and the layer behind it, so both are one matrix here. One
//! hypernetwork feeds all parts of a mixer, where the public code has one for each part.

use std::ops::Range;

use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;

use super::MixerTensor;
use crate::alma::agents::{AttentionGradients, AttentionWeights, EntityAttention, UtilityInput};
use crate::sized;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct HypernetworkShape {
    /// Input columns D of one entity, as of the utility network.
    pub(super) input: usize,
    /// Width E of the embedding and the attention.
    pub(super) width: usize,
    /// Attention heads, a divisor of the width.
    pub(super) heads: usize,
    /// Numbers K for each agent.
    pub(super) outputs: usize,
}

impl HypernetworkShape {
    fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    fn project(self) -> LinearShape {
        LinearShape { input: self.width, output: self.outputs }
    }

    /// Where each tensor stands in the flat parameter vector. `fc1.weight` is `[D, E]`, the others
    /// `[out, in]`.
    pub(super) fn tensors(self) -> [MixerTensor; 5] {
        let Self { input, width, outputs, .. } = self;
        let mut start = 0;
        let mut next = |name, inputs, count| {
            let range = start..start + count;
            start = range.end;
            MixerTensor { name, inputs, range }
        };
        [
            next("fc1.weight", input, input * width),
            next("fc1.bias", input, width),
            next("attention.in.weight", width, 3 * width * width),
            next("project.weight", width, outputs * width),
            next("project.bias", width, outputs),
        ]
    }

    fn ranges(self) -> [Range<usize>; 5] {
        self.tensors().map(|tensor| tensor.range)
    }
}

/// Buffers of one worker.
#[derive(Clone, Debug, Default)]
pub(super) struct HypernetworkPass {
    attention: EntityAttention,
    outputs: Vec<f32>,
    d_attended: Vec<f32>,
}

impl HypernetworkPass {
    /// Computes the numbers `[queries, K]` of all agents that act.
    pub(super) fn forward(
        &mut self,
        shape: HypernetworkShape,
        parameters: &[f32],
        input: &UtilityInput,
    ) -> &[f32] {
        let (attention, weight, bias) = view(shape, parameters);
        let attended = self.attention.forward(shape.attention(), attention, input);
        let outputs = sized(&mut self.outputs, input.visible.queries() * shape.outputs);
        linear::forward(shape.project(), attended, weight, bias, outputs);
        outputs
    }

    /// Adds to `gradient` (all parameters) the gradient of a loss whose slope by the numbers of the last
    /// forward pass is `d_outputs [queries, K]`.
    pub(super) fn backward(
        &mut self,
        shape: HypernetworkShape,
        parameters: &[f32],
        input: &UtilityInput,
        d_outputs: &[f32],
        gradient: &mut [f32],
    ) {
        let (attention, weight, _) = view(shape, parameters);
        let mut rest = gradient;
        let mut take = |range: Range<usize>| {
            rest.split_off_mut(..range.len()).expect("one place per parameter")
        };
        let [fc1, fc1_bias, attention_in, d_weight, d_bias] = shape.ranges().map(&mut take);
        let (queries, keys_values) = attention_in.split_at_mut(shape.width * shape.width);

        let numbers = input.visible.queries() * shape.width;
        let attended = self.attention.attended(numbers);
        let d_attended = sized(&mut self.d_attended, numbers);
        linear::backward_weight(shape.project(), attended, d_outputs, d_weight);
        linear::backward_bias(d_outputs, d_bias);
        linear::backward_input(shape.project(), d_outputs, weight, Store::Replace, d_attended);
        let gradients = AttentionGradients { fc1, fc1_bias, queries, keys_values };
        self.attention.backward(shape.attention(), attention, input, d_attended, None, gradients);
    }
}

/// The weights of embedding and attention, the projection's matrix and its bias.
fn view(shape: HypernetworkShape, parameters: &[f32]) -> (AttentionWeights<'_>, &[f32], &[f32]) {
    let [fc1, fc1_bias, attention_in, weight, bias] =
        shape.ranges().map(|range| &parameters[range]);
    let (queries, keys_values) = attention_in.split_at(shape.width * shape.width);
    (AttentionWeights { fc1, fc1_bias, queries, keys_values }, weight, bias)
}
