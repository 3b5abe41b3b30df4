//! Forward and backward passes of the utility network over many samples at once, and the network in training as a policy,
//! agent by agent, as deployment asks for it.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, NO_ACTION, Observation, Policy};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::{linear, relu};

use super::entity_attention::{EntityAttention, SkipBackward, UtilityInput, absorbs};
use super::utility::{UtilityNetwork, UtilityShape, UtilityViewMut};
use crate::sized;

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
        self.operations += forward_operations(shape, input);
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
        self.operations += backward_operations(shape, input);
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

/// Floating-point operations of a forward pass, where a multiplication and an addition count as two.
///
/// Counted over the rows, agents and pairs that are really there: matrix products, the sparse first layer, attention's
/// scores and weighted sums. Not counted, and small: softmax, rectifiers, biases.
fn forward_operations(shape: UtilityShape, input: &UtilityInput) -> u64 {
    2 * (first_layer_products(shape, input)
        + attention_products(shape, input)
        + head_products(shape, input)) as u64
}

/// Those of a backward pass: each product has two gradients, features have none.
fn backward_operations(shape: UtilityShape, input: &UtilityInput) -> u64 {
    2 * (first_layer_products(shape, input)
        + 2 * attention_products(shape, input)
        + 2 * head_products(shape, input)) as u64
}

fn first_layer_products(shape: UtilityShape, input: &UtilityInput) -> usize {
    input.rows.entries() * shape.width
}

/// Multiplications of the attention: queries, then keys and values or what stands in for them, then a
/// score and a weighted row for each pair.
fn attention_products(shape: UtilityShape, input: &UtilityInput) -> usize {
    let UtilityShape { width, heads, .. } = shape;
    let (rows, queries, pairs) = (input.rows.len(), input.visible.queries(), input.visible.pairs());
    let matrix = width * width;
    queries * matrix
        + if absorbs(shape.attention(), input) {
            2 * queries * matrix + 2 * pairs * heads * width
        } else {
            2 * rows * matrix + 2 * pairs * width
        }
}

/// Multiplications of the three layers behind the attention, and of the skip beside it.
fn head_products(shape: UtilityShape, input: &UtilityInput) -> usize {
    let UtilityShape { width, base, actions, skip, .. } = shape;
    let looked = if skip { 2 * width * width } else { width * width };
    input.visible.queries() * (looked + width * base + base * actions)
}

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
#[derive(Debug)]
pub struct NetworkPolicy<'a> {
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    input: UtilityInput,
    utilities: Vec<f32>,
}

impl<'a> NetworkPolicy<'a> {
    /// Decides with a network.
    pub fn new(network: &'a UtilityNetwork) -> Self {
        let shape = network.shape();
        Self {
            network,
            pass: UtilityPass::new(shape),
            input: UtilityInput::default(),
            utilities: vec![0.0; shape.actions],
        }
    }

    /// What the last answer attended to: every visible entity of `observation`, which must be the one
    /// that was answered, with its weights `[heads]`; those of one head sum to 1.
    pub fn attention(
        &self,
        observation: &Observation<'_>,
    ) -> impl Iterator<Item = (usize, &[f32])> {
        let own = observation.self_index;
        let visible = observation.visible;
        let own_first = visible.contains(own).then_some(own);
        let others: Vec<usize> = visible.iter().filter(|entity| *entity != own).collect();
        let weights = self.pass.attention(&self.input);
        own_first.into_iter().chain(others).zip(weights.chunks_exact(self.network.shape().heads))
    }

    /// The agent's own row comes first, as the query; what it sees follows.
    fn fill(&mut self, observation: &Observation<'_>) -> Result<(), DecideError> {
        let own = observation.self_index;
        let others = observation.visible.iter().filter(|entity| *entity != own);
        self.input.clear();
        for (place, entity) in std::iter::once(own).chain(others).enumerate() {
            self.push_row(observation, entity)?;
            if place > 0 || observation.visible.contains(own) {
                self.input.visible.push(place);
            }
        }
        self.input.visible.end_list();
        Ok(())
    }

    /// Features of an entity: the columns before its last action.
    fn features(&self) -> usize {
        let shape = self.network.shape();
        shape.input - shape.actions
    }

    fn push_row(
        &mut self,
        observation: &Observation<'_>,
        entity: usize,
    ) -> Result<(), DecideError> {
        let features = self.features();
        let row = observation.rows.get(entity * observation.stride..);
        let row = row.and_then(|row| row.get(..features)).ok_or(DecideError::BadLength)?;
        for (column, value) in row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            self.input.rows.push(column, *value);
        }
        let last_action = observation.last_actions.get(entity).filter(|&&last| last != NO_ACTION);
        if let Some(action) = last_action {
            self.input.rows.push(features + usize::from(*action), 1.0);
        }
        self.input.rows.end_row();
        Ok(())
    }
}

impl Policy for NetworkPolicy<'_> {
    fn actions(&self) -> usize {
        self.network.shape().actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.fill(observation)?;
        let computed = self.pass.forward(self.network, &self.input);
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(computed);
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = std::mem::take(&mut self.utilities);
        let decision = self
            .utilities(observation, &mut utilities)
            .and_then(|()| masked_argmax(&utilities, observation.available));
        self.utilities = utilities;
        decision
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: UtilityShape =
        UtilityShape { input: 9, width: 4, heads: 2, base: 3, actions: 5, skip: false };

    /// One query that sees itself and so many others, each with two features.
    fn seeing(others: usize) -> UtilityInput {
        let mut input = UtilityInput::default();
        for row in 0..=others {
            input.rows.push_dense(&[0.0, 1.0, 2.0]);
            input.visible.push(row);
        }
        input.visible.end_list();
        input
    }

    #[test]
    fn only_what_is_there_counts() {
        // Keys and values of two rows are fewer multiplications than what absorbs them.
        let (first, attention) = (4 * 4, 16 + 2 * 2 * 16 + 2 * 2 * 4);
        let head = 16 + 12 + 15;
        assert_eq!(forward_operations(SHAPE, &seeing(1)), 2 * (first + attention + head));
        assert_eq!(backward_operations(SHAPE, &seeing(1)), 2 * (first + 2 * attention + 2 * head));
        let skipping = UtilityShape { skip: true, ..SHAPE };
        assert_eq!(
            forward_operations(skipping, &seeing(1)),
            forward_operations(SHAPE, &seeing(1)) + 2 * 16
        );
        assert_eq!(
            backward_operations(skipping, &seeing(1)),
            backward_operations(SHAPE, &seeing(1)) + 2 * 2 * 16
        );
    }

    #[test]
    fn absorbed_keys_count_per_query() {
        let shape = UtilityShape { width: 64, heads: 1, ..SHAPE };
        let (queries, pairs) = (64 * 64, 10 * 64);
        let first = 20 * 64;
        let head = 64 * 64 + 64 * 3 + 15;
        let attention = queries + 2 * queries + 2 * pairs;
        assert_eq!(forward_operations(shape, &seeing(9)), 2 * (first + attention + head));
    }
}
