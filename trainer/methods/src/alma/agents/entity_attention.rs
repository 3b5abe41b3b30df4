//! Entities embedded and looked at: what utility network and hypernetwork begin with.
//!
//! `fc1` and ReLU embed every entity, then each acting agent attends to what it sees (dissertation
//! section 2.3). The projection behind the attention belongs to the networks that use this.

use sortie_nn::layers::absorbed_attention::{AbsorbedAttention, AbsorbedBackward};
use sortie_nn::layers::attention::{self, AttentionShape, Backward};
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::{SparseRows, VisibleLists, relu, sparse_linear};

use crate::sized;

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

/// The weights, borrowed from a flat parameter vector.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AttentionWeights<'a> {
    /// `[D, E]`
    pub(crate) fc1: &'a [f32],
    /// `[E]`
    pub(crate) fc1_bias: &'a [f32],
    /// `[E, E]`
    pub(crate) queries: &'a [f32],
    /// `[2 E, E]`
    pub(crate) keys_values: &'a [f32],
}

/// Their gradients, to be added to.
#[derive(Debug)]
pub(crate) struct AttentionGradients<'a> {
    pub(crate) fc1: &'a mut [f32],
    pub(crate) fc1_bias: &'a mut [f32],
    pub(crate) queries: &'a mut [f32],
    pub(crate) keys_values: &'a mut [f32],
}

/// What the own embeddings went through beside the attention: a matrix `[E, E]`, the slope `[queries, E]`
/// by what it gave, and its gradient, to be added to.
#[derive(Debug)]
pub(crate) struct SkipBackward<'a> {
    pub(crate) weights: &'a [f32],
    pub(crate) d_output: &'a [f32],
    pub(crate) gradient: &'a mut [f32],
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(crate) struct EntityAttention {
    embedding: Vec<f32>,
    queries: Vec<f32>,
    keys_values: Vec<f32>,
    weights: Vec<f32>,
    attended: Vec<f32>,
    absorbed: AbsorbedAttention,
    d_embedding: Vec<f32>,
    d_queries: Vec<f32>,
    d_keys_values: Vec<f32>,
    d_scores: Vec<f32>,
}

impl EntityAttention {
    /// Computes what each acting agent attends to, `[queries, E]`.
    pub(crate) fn forward(
        &mut self,
        shape: AttentionShape,
        view: AttentionWeights<'_>,
        input: &UtilityInput,
    ) -> &[f32] {
        let width = shape.width;
        let (rows, queries) = (input.rows.len(), input.visible.queries());
        let embedding = sized(&mut self.embedding, rows * width);
        sparse_linear::forward(&input.rows, view.fc1, view.fc1_bias, embedding);
        relu::forward(embedding);

        let own = &embedding[..queries * width];
        let query = sized(&mut self.queries, queries * width);
        linear::forward_without_bias(to_queries(width), own, view.queries, query);
        let attended = sized(&mut self.attended, queries * width);
        if absorbs(shape, input) {
            let tensors = (&*query, &*embedding);
            self.absorbed.forward(shape, &input.visible, view.keys_values, tensors, attended);
            return attended;
        }
        let keys_values = sized(&mut self.keys_values, rows * 2 * width);
        let projection = to_keys_values(width);
        linear::forward_without_bias(projection, embedding, view.keys_values, keys_values);
        let weights = sized(&mut self.weights, input.visible.pairs() * shape.heads);
        attention::forward(shape, &input.visible, query, keys_values, weights, attended);
        attended
    }

    /// The weights `[pairs, heads]` of the last forward pass, which was about `input`.
    pub(super) fn weights(&self, shape: AttentionShape, input: &UtilityInput) -> &[f32] {
        let weights = if absorbs(shape, input) { self.absorbed.weights() } else { &self.weights };
        &weights[..input.visible.pairs() * shape.heads]
    }

    /// What the last forward pass computed for so many numbers.
    pub(crate) fn attended(&self, numbers: usize) -> &[f32] {
        &self.attended[..numbers]
    }

    /// The acting agents' own embeddings of the last forward pass, so many numbers.
    pub(crate) fn own(&self, numbers: usize) -> &[f32] {
        &self.embedding[..numbers]
    }

    /// Adds the gradients of a loss whose slope by the attended is `d_attended [queries, E]`; that of a skip
    /// comes to the own embeddings as well.
    pub(crate) fn backward(
        &mut self,
        shape: AttentionShape,
        view: AttentionWeights<'_>,
        input: &UtilityInput,
        d_attended: &[f32],
        skip: Option<SkipBackward<'_>>,
        gradients: AttentionGradients<'_>,
    ) {
        let width = shape.width;
        let (rows, queries) = (input.rows.len(), input.visible.queries());
        let own = queries * width;
        sized(&mut self.d_queries, own);
        sized(&mut self.d_embedding, rows * width);
        if absorbs(shape, input) {
            let pass = AbsorbedBackward {
                queries: &self.queries[..own],
                entities: &self.embedding[..rows * width],
                d_output: d_attended,
                d_queries: &mut self.d_queries[..own],
                d_entities: &mut self.d_embedding[..rows * width],
                d_keys_values: gradients.keys_values,
            };
            self.absorbed.backward(shape, &input.visible, view.keys_values, pass);
        } else {
            self.backward_keys_values(shape, view, input, d_attended, gradients.keys_values);
        }

        let embedding = &self.embedding[..rows * width];
        let (d_queries, d_embedding) =
            (&self.d_queries[..own], &mut self.d_embedding[..rows * width]);
        let (own, d_own) = (&embedding[..own], &mut d_embedding[..own]);
        linear::backward_weight(to_queries(width), own, d_queries, gradients.queries);
        linear::backward_input(to_queries(width), d_queries, view.queries, Store::Add, d_own);
        if let Some(SkipBackward { weights, d_output, gradient }) = skip {
            linear::backward_weight(to_queries(width), own, d_output, gradient);
            linear::backward_input(to_queries(width), d_output, weights, Store::Add, d_own);
        }
        relu::backward(embedding, d_embedding);
        sparse_linear::backward(&input.rows, d_embedding, gradients.fc1, gradients.fc1_bias);
    }

    /// Goes back through attention, keys and values to queries and embedding.
    fn backward_keys_values(
        &mut self,
        shape: AttentionShape,
        view: AttentionWeights<'_>,
        input: &UtilityInput,
        d_attended: &[f32],
        gradient: &mut [f32],
    ) {
        let width = shape.width;
        let (rows, queries) = (input.rows.len(), input.visible.queries());
        let d_keys_values = sized(&mut self.d_keys_values, rows * 2 * width);
        let pass = Backward {
            queries: &self.queries,
            keys_values: &self.keys_values,
            weights: &self.weights,
            d_output: d_attended,
            d_scores: sized(&mut self.d_scores, rows * shape.heads),
            d_queries: &mut self.d_queries[..queries * width],
            d_keys_values: &mut *d_keys_values,
        };
        attention::backward(shape, &input.visible, pass);
        let projection = to_keys_values(width);
        let (embedding, d_embedding) =
            (&self.embedding[..rows * width], &mut self.d_embedding[..rows * width]);
        linear::backward_weight(projection, embedding, d_keys_values, gradient);
        let weights = view.keys_values;
        linear::backward_input(projection, d_keys_values, weights, Store::Replace, d_embedding);
    }
}

/// Whether queries absorb their keys, because that takes fewer multiplications than keys and values.
///
/// The products of whole matrices that keys and values allow are faster than the sums over pairs, so
/// pairs count twice.
pub(super) fn absorbs(shape: AttentionShape, input: &UtilityInput) -> bool {
    let matrix = 2 * shape.width * shape.width;
    let pair = 2 * shape.heads * shape.width;
    let (rows, queries) = (input.rows.len(), input.visible.queries());
    queries * matrix + 4 * input.visible.pairs() * pair < rows * matrix
}

fn to_queries(width: usize) -> LinearShape {
    LinearShape { input: width, output: width }
}

fn to_keys_values(width: usize) -> LinearShape {
    LinearShape { input: width, output: 2 * width }
}
