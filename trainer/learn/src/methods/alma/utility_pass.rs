//! Forward and backward passes of the utility network over many samples at once.

use super::operations;
use super::utility::{UtilityNetwork, UtilityShape, UtilityViewMut};
use crate::layers::attention::{self, Backward};
use crate::layers::matrix::Store;
use crate::layers::{SparseRows, VisibleLists, linear, relu, sparse_linear};

/// What the network looks at: the entities of any number of independent samples.
///
/// Query i belongs to row i: the rows of all acting agents come first, then the other entities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UtilityInput {
    /// Features `[rows, D]` of every entity, last actions included.
    pub rows: SparseRows,
    /// For each acting agent the rows that it sees, its own among them where it is visible.
    pub visible: VisibleLists,
}

impl UtilityInput {
    /// Forgets all samples, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.visible.clear();
    }
}

/// Buffers of one worker: the activations of the last forward pass and the gradients of a backward pass.
///
/// They grow to the largest input seen, so that a steady stream of inputs allocates nothing.
#[derive(Clone, Debug)]
pub struct UtilityPass {
    shape: UtilityShape,
    embedding: Vec<f32>,
    queries: Vec<f32>,
    keys_values: Vec<f32>,
    weights: Vec<f32>,
    attended: Vec<f32>,
    looked: Vec<f32>,
    base: Vec<f32>,
    utilities: Vec<f32>,
    d_embedding: Vec<f32>,
    d_queries: Vec<f32>,
    d_keys_values: Vec<f32>,
    d_scores: Vec<f32>,
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
            embedding: Vec::new(),
            queries: Vec::new(),
            keys_values: Vec::new(),
            weights: Vec::new(),
            attended: Vec::new(),
            looked: Vec::new(),
            base: Vec::new(),
            utilities: Vec::new(),
            d_embedding: Vec::new(),
            d_queries: Vec::new(),
            d_keys_values: Vec::new(),
            d_scores: Vec::new(),
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
        let shape = self.shape;
        assert_eq!(network.shape(), shape, "network of another shape");
        self.operations += operations::forward(shape, input);
        let (rows, queries) = (input.rows.len(), input.visible.queries());
        let view = network.view();

        let embedding = sized(&mut self.embedding, rows * shape.width);
        sparse_linear::forward(&input.rows, view.fc1, view.fc1_bias, embedding);
        relu::forward(embedding);

        let own = &embedding[..queries * shape.width];
        let query = sized(&mut self.queries, queries * shape.width);
        linear::forward_without_bias(shape.queries(), own, view.queries, query);
        let keys_values = sized(&mut self.keys_values, rows * 2 * shape.width);
        linear::forward_without_bias(shape.keys_values(), embedding, view.keys_values, keys_values);
        let weights = sized(&mut self.weights, input.visible.pairs() * shape.heads);
        let attended = sized(&mut self.attended, queries * shape.width);
        attention::forward(
            shape.attention(),
            &input.visible,
            query,
            keys_values,
            weights,
            attended,
        );

        let looked = sized(&mut self.looked, queries * shape.width);
        linear::forward(shape.queries(), attended, view.out, view.out_bias, looked);
        relu::forward(looked);
        let base = sized(&mut self.base, queries * shape.base);
        linear::forward(shape.fc2(), looked, view.fc2, view.fc2_bias, base);
        relu::forward(base);
        let utilities = sized(&mut self.utilities, queries * shape.actions);
        linear::forward(shape.head(), base, view.head, view.head_bias, utilities);
        utilities
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
        let shape = self.shape;
        let (rows, queries) = (input.rows.len(), input.visible.queries());
        let view = network.view();
        self.operations += operations::backward(shape, input);
        let grad = UtilityViewMut::new(shape, gradient);

        let embedding = &self.embedding[..rows * shape.width];
        let attended = &self.attended[..queries * shape.width];
        let looked = &self.looked[..queries * shape.width];
        let base = &self.base[..queries * shape.base];

        let d_base = sized(&mut self.d_base, queries * shape.base);
        linear::backward_weight(shape.head(), base, d_utilities, grad.head);
        linear::backward_bias(d_utilities, grad.head_bias);
        linear::backward_input(shape.head(), d_utilities, view.head, Store::Replace, d_base);
        relu::backward(base, d_base);

        let d_looked = sized(&mut self.d_looked, queries * shape.width);
        linear::backward_weight(shape.fc2(), looked, d_base, grad.fc2);
        linear::backward_bias(d_base, grad.fc2_bias);
        linear::backward_input(shape.fc2(), d_base, view.fc2, Store::Replace, d_looked);
        relu::backward(looked, d_looked);

        let d_attended = sized(&mut self.d_attended, queries * shape.width);
        linear::backward_weight(shape.queries(), attended, d_looked, grad.out);
        linear::backward_bias(d_looked, grad.out_bias);
        linear::backward_input(shape.queries(), d_looked, view.out, Store::Replace, d_attended);

        let d_queries = sized(&mut self.d_queries, queries * shape.width);
        let d_keys_values = sized(&mut self.d_keys_values, rows * 2 * shape.width);
        attention::backward(
            shape.attention(),
            &input.visible,
            Backward {
                queries: &self.queries,
                keys_values: &self.keys_values,
                weights: &self.weights,
                d_output: d_attended,
                d_scores: sized(&mut self.d_scores, rows * shape.heads),
                d_queries,
                d_keys_values,
            },
        );

        let own = queries * shape.width;
        let d_embedding = sized(&mut self.d_embedding, rows * shape.width);
        linear::backward_weight(shape.keys_values(), embedding, d_keys_values, grad.keys_values);
        linear::backward_weight(shape.queries(), &embedding[..own], d_queries, grad.queries);
        linear::backward_input(
            shape.keys_values(),
            d_keys_values,
            view.keys_values,
            Store::Replace,
            d_embedding,
        );
        let d_own = &mut d_embedding[..own];
        linear::backward_input(shape.queries(), d_queries, view.queries, Store::Add, d_own);
        relu::backward(embedding, d_embedding);
        sparse_linear::backward(&input.rows, d_embedding, grad.fc1, grad.fc1_bias);
    }
}

/// The first `length` numbers of a buffer that grows but never shrinks; their content is whatever
/// stood there.
fn sized(buffer: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
    &mut buffer[..length]
}
