//! What coach and recognition network begin with: entities embedded, agents that look at all of them.

use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::relu;

use crate::alma::agents::{
    AttentionGradients, AttentionWeights, EntityAttention, UtilityInput, sized,
};

/// Sizes of a trunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TrunkShape {
    /// Input columns of one entity.
    pub(super) input: usize,
    /// Width E of embedding and attention.
    pub(super) width: usize,
    /// Attention heads, a divisor of the width.
    pub(super) heads: usize,
}

impl TrunkShape {
    /// Lengths of `fc1.weight [input, E]`, `fc1.bias`, queries, keys and values, `out.weight`, `out.bias`.
    fn lengths(self) -> [usize; 6] {
        let Self { input, width, .. } = self;
        let square = width * width;
        [input * width, width, square, 2 * square, square, width]
    }

    /// Number of parameters.
    pub(super) fn parameters(self) -> usize {
        self.lengths().iter().sum()
    }

    fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    fn square(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    fn view(self, parameters: &[f32]) -> (AttentionWeights<'_>, &[f32], &[f32]) {
        let mut rest = parameters;
        let [fc1, fc1_bias, queries, keys_values, out, out_bias] =
            self.lengths().map(|length| rest.split_off(..length).expect("all tensors"));
        (AttentionWeights { fc1, fc1_bias, queries, keys_values }, out, out_bias)
    }

    fn view_mut(self, vector: &mut [f32]) -> (AttentionGradients<'_>, &mut [f32], &mut [f32]) {
        let mut rest = vector;
        let [fc1, fc1_bias, queries, keys_values, out, out_bias] =
            self.lengths().map(|length| rest.split_off_mut(..length).expect("all tensors"));
        (AttentionGradients { fc1, fc1_bias, queries, keys_values }, out, out_bias)
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct TrunkPass {
    attention: EntityAttention,
    looked: Vec<f32>,
    d_attended: Vec<f32>,
}

impl TrunkPass {
    /// Computes what each agent makes of all it looks at, `[queries, E]`, rectified.
    pub(super) fn forward(
        &mut self,
        shape: TrunkShape,
        parameters: &[f32],
        input: &UtilityInput,
    ) -> &[f32] {
        let (weights, out, out_bias) = shape.view(parameters);
        let attended = self.attention.forward(shape.attention(), weights, input);
        let looked = sized(&mut self.looked, attended.len());
        linear::forward_rectified(shape.square(), attended, out, out_bias, looked);
        looked
    }

    /// What the last forward pass computed for so many agents.
    pub(super) fn looked(&self, shape: TrunkShape, queries: usize) -> &[f32] {
        &self.looked[..queries * shape.width]
    }

    /// Adds the gradients of a loss whose slope by what the last forward pass computed is `d_looked`,
    /// which is rectified in place.
    pub(super) fn backward(
        &mut self,
        shape: TrunkShape,
        parameters: &[f32],
        input: &UtilityInput,
        d_looked: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (weights, out, _) = shape.view(parameters);
        let (gradients, d_out, d_out_bias) = shape.view_mut(gradient);
        relu::backward(&self.looked[..d_looked.len()], d_looked);
        let attended = self.attention.attended(d_looked.len());
        linear::backward_weight(shape.square(), attended, d_looked, d_out);
        linear::backward_bias(d_looked, d_out_bias);
        let d_attended = sized(&mut self.d_attended, d_looked.len());
        linear::backward_input(shape.square(), d_looked, out, Store::Replace, d_attended);
        self.attention.backward(shape.attention(), weights, input, d_attended, None, gradients);
    }
}
