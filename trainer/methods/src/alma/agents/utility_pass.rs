//! Forward and backward passes of the utility network over many samples at once.

use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::{linear, relu};

use super::entity_attention::EntityAttention;

use super::entity_attention::SkipBackward;
use super::operations;
use super::utility::{UtilityNetwork, UtilityShape, UtilityViewMut};
use super::utility_input::{UtilityInput, sized};

/// Buffers of one worker: the activations of the last forward pass and the gradients of a backward pass.
///
/// They grow to the largest input seen, so that a steady stream of inputs allocates nothing.
#[derive(Clone, Debug)]
pub struct UtilityPass {
    shape: UtilityShape,
    attention: EntityAttention,
    looked: Vec<f32>,
    base: Vec<f32>,
    utilities: Vec<f32>,
    d_attended: Vec<f32>,
    d_looked: Vec<f32>,
    d_base: Vec<f32>,
    operations: u64,
}

impl UtilityPass {
    /// Empty buffers for networks of a shape.
    pub fn new(shape: UtilityShape) -> Self {
        Self {
            shape,
            attention: EntityAttention::default(),
            looked: Vec::new(),
            base: Vec::new(),
            utilities: Vec::new(),
            d_attended: Vec::new(),
            d_looked: Vec::new(),
            d_base: Vec::new(),
            operations: 0,
        }
    }

    /// Floating-point operations of all passes up to now: those of matrix products and attention, a
    /// multiplication and an addition being two.
    pub fn operations(&self) -> u64 {
        self.operations
    }

    /// Computes the utilities `[queries, U]`. Panics if the network has another shape.
    pub fn forward(&mut self, network: &UtilityNetwork, input: &UtilityInput) -> &[f32] {
        self.forward_base(network, input);
        let base = std::mem::take(&mut self.base);
        self.forward_head(network, &base[..input.visible.queries() * self.shape.base]);
        self.base = base;
        &self.utilities[..input.visible.queries() * self.shape.actions]
    }

    /// Computes what stands before the head, `[queries, R]`. Panics if the network has another shape.
    pub(crate) fn forward_base(
        &mut self,
        network: &UtilityNetwork,
        input: &UtilityInput,
    ) -> &mut [f32] {
        let shape = self.shape;
        assert_eq!(network.shape(), shape, "network of another shape");
        self.operations += operations::forward(shape, input);
        let queries = input.visible.queries();
        let view = network.view();

        self.attention.forward(shape.attention(), view.attention, input);
        let looked = sized(&mut self.looked, queries * shape.width);
        let attended = self.attention.attended(looked.len());
        let (layer, out, bias) = (shape.queries(), view.out, view.out_bias);
        if let Some(skip) = view.skip {
            let own = self.attention.own(looked.len());
            linear::forward_rectified_sum(layer, [(attended, out), (own, skip)], bias, looked);
        } else {
            linear::forward_rectified(layer, attended, out, bias, looked);
        }
        let base = sized(&mut self.base, queries * shape.base);
        linear::forward_rectified(shape.fc2(), looked, view.fc2, view.fc2_bias, base);
        base
    }

    /// Computes utilities `[rows, U]` from what stands before the head, `[rows, R]`.
    pub(crate) fn forward_head(&mut self, network: &UtilityNetwork, base: &[f32]) -> &[f32] {
        let (shape, view) = (self.shape, network.view());
        let utilities = sized(&mut self.utilities, base.len() / shape.base * shape.actions);
        linear::forward(shape.head(), base, view.head, view.head_bias, utilities);
        utilities
    }

    /// The attention weights `[pairs, heads]` of the last forward pass, which was about `input`: pair by
    /// pair in the order of the visible lists.
    pub fn attention(&self, input: &UtilityInput) -> &[f32] {
        self.attention.weights(self.shape.attention(), input)
    }

    /// Adds to `gradient` (all parameters) the gradient of a loss whose slope by the utilities of the
    /// last forward pass is `d_utilities [queries, U]`.
    pub fn backward(
        &mut self,
        network: &UtilityNetwork,
        input: &UtilityInput,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) {
        let numbers = input.visible.queries() * self.shape.base;
        let base = std::mem::take(&mut self.base);
        let mut d_base = std::mem::take(&mut self.d_base);
        let d_own = sized(&mut d_base, numbers);
        self.backward_head(network, &base[..numbers], d_utilities, d_own, gradient);
        self.base = base;
        self.backward_base(network, input, d_own, gradient);
        self.d_base = d_base;
    }

    /// Adds to `gradient` that of the head, and writes the slope by what stands before it.
    pub(crate) fn backward_head(
        &self,
        network: &UtilityNetwork,
        base: &[f32],
        d_utilities: &[f32],
        d_base: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (shape, view) = (self.shape, network.view());
        let grad = UtilityViewMut::new(shape, gradient);
        linear::backward_weight(shape.head(), base, d_utilities, grad.head);
        linear::backward_bias(d_utilities, grad.head_bias);
        linear::backward_input(shape.head(), d_utilities, view.head, Store::Replace, d_base);
    }

    /// Adds to `gradient` that of everything before the head, from the slope by what the last forward
    /// pass computed there, which is rectified in place.
    pub(crate) fn backward_base(
        &mut self,
        network: &UtilityNetwork,
        input: &UtilityInput,
        d_base: &mut [f32],
        gradient: &mut [f32],
    ) {
        let shape = self.shape;
        let queries = input.visible.queries();
        let view = network.view();
        self.operations += operations::backward(shape, input);
        let grad = UtilityViewMut::new(shape, gradient);

        let attended = self.attention.attended(queries * shape.width);
        let looked = &self.looked[..queries * shape.width];
        relu::backward(&self.base[..queries * shape.base], d_base);

        let d_looked = sized(&mut self.d_looked, queries * shape.width);
        linear::backward_weight(shape.fc2(), looked, d_base, grad.fc2);
        linear::backward_bias(d_base, grad.fc2_bias);
        linear::backward_input(shape.fc2(), d_base, view.fc2, Store::Replace, d_looked);
        relu::backward(looked, d_looked);

        let d_attended = sized(&mut self.d_attended, queries * shape.width);
        linear::backward_weight(shape.queries(), attended, d_looked, grad.out);
        linear::backward_bias(d_looked, grad.out_bias);
        linear::backward_input(shape.queries(), d_looked, view.out, Store::Replace, d_attended);
        let skip = view.skip.map(|weights| SkipBackward {
            weights,
            d_output: d_looked,
            gradient: grad.skip,
        });
        self.attention.backward(
            shape.attention(),
            view.attention,
            input,
            d_attended,
            skip,
            grad.attention,
        );
    }
}
