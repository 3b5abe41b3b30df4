//! Entities embedded and looked at: what agents and hypernetworks begin with.

use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::{SparseRows, relu, sparse_linear};

use super::buffers::sized;
use super::split_attention::{self, Backward, Forward, HEADS, SplitLists};

/// The weights, borrowed from a parameter vector.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights<'a> {
    /// `[D, E]`
    pub(super) fc1: &'a [f32],
    /// `[E]`
    pub(super) fc1_bias: &'a [f32],
    /// `[3 E, E]`: queries, keys, values.
    pub(super) attention_in: &'a [f32],
}

/// Their gradients, to be added to.
#[derive(Debug)]
pub(super) struct Gradients<'a> {
    pub(super) fc1: &'a mut [f32],
    pub(super) fc1_bias: &'a mut [f32],
    pub(super) attention_in: &'a mut [f32],
}

/// Activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct Looking {
    embedding: Vec<f32>,
    queries: Vec<f32>,
    keys_values: Vec<f32>,
    weights: Vec<f32>,
    shares: Vec<f32>,
    attended: Vec<f32>,
    d_embedding: Vec<f32>,
    d_queries: Vec<f32>,
    d_keys_values: Vec<f32>,
    d_scores: Vec<f32>,
}

fn square(width: usize) -> LinearShape {
    LinearShape { input: width, output: width }
}

fn keys_values_of(width: usize) -> LinearShape {
    LinearShape { input: width, output: 2 * width }
}

impl Looking {
    /// Computes what each agent attends to, `[blocks, agents, E]`.
    pub(super) fn forward(
        &mut self,
        width: usize,
        weights: Weights<'_>,
        rows: &SparseRows,
        lists: &SplitLists,
        blocks: usize,
    ) -> &[f32] {
        let agents = lists.queries();
        let embedding = sized(&mut self.embedding, rows.len() * width);
        sparse_linear::forward(rows, weights.fc1, weights.fc1_bias, embedding);
        relu::forward(embedding);
        let (to_queries, to_keys_values) = weights.attention_in.split_at(width * width);
        let queries = sized(&mut self.queries, agents * width);
        linear::forward_without_bias(
            square(width),
            &embedding[..agents * width],
            to_queries,
            queries,
        );
        let keys_values = sized(&mut self.keys_values, rows.len() * 2 * width);
        linear::forward_without_bias(keys_values_of(width), embedding, to_keys_values, keys_values);
        let output = sized(&mut self.attended, blocks * agents * width);
        let pass = Forward {
            queries,
            keys_values,
            weights: sized(&mut self.weights, lists.pairs() * HEADS),
            shares: sized(&mut self.shares, agents * HEADS),
            output,
        };
        split_attention::forward(width, lists, pass);
        output
    }

    /// The agents' own embeddings in the last forward pass, so many numbers.
    pub(super) fn own(&self, numbers: usize) -> &[f32] {
        &self.embedding[..numbers]
    }

    /// What the last forward pass computed, so many numbers.
    pub(super) fn attended(&self, numbers: usize) -> &[f32] {
        &self.attended[..numbers]
    }

    /// Adds the gradients of a loss whose slope by the attended is `d_attended`, and whose slope by the
    /// agents' own embeddings, past the attention, is `d_own [agents, E]` where there is one.
    pub(super) fn backward(
        &mut self,
        width: usize,
        weights: Weights<'_>,
        (rows, lists): (&SparseRows, &SplitLists),
        d_attended: &[f32],
        d_own: Option<&[f32]>,
        gradients: Gradients<'_>,
    ) {
        let agents = lists.queries();
        let d_queries = sized(&mut self.d_queries, agents * width);
        let d_keys_values = sized(&mut self.d_keys_values, rows.len() * 2 * width);
        let pass = Backward {
            queries: &self.queries[..agents * width],
            keys_values: &self.keys_values[..rows.len() * 2 * width],
            weights: &self.weights[..lists.pairs() * HEADS],
            shares: &self.shares[..agents * HEADS],
            output: &self.attended[..d_attended.len()],
            d_output: d_attended,
            d_scores: sized(&mut self.d_scores, lists.pairs() * HEADS),
            d_queries,
            d_keys_values,
        };
        split_attention::backward(width, lists, pass);

        let embedding = &self.embedding[..rows.len() * width];
        let d_embedding = sized(&mut self.d_embedding, rows.len() * width);
        let own = agents * width;
        let (to_queries, to_keys_values) = weights.attention_in.split_at(width * width);
        let (d_to_queries, d_to_keys_values) = gradients.attention_in.split_at_mut(width * width);
        let shape = keys_values_of(width);
        linear::backward_weight(shape, embedding, d_keys_values, d_to_keys_values);
        linear::backward_input(shape, d_keys_values, to_keys_values, Store::Replace, d_embedding);
        let shape = square(width);
        linear::backward_weight(shape, &embedding[..own], d_queries, d_to_queries);
        linear::backward_input(shape, d_queries, to_queries, Store::Add, &mut d_embedding[..own]);
        for (slope, own) in d_embedding.iter_mut().zip(d_own.unwrap_or_default()) {
            *slope += own;
        }
        relu::backward(embedding, d_embedding);
        sparse_linear::backward(rows, d_embedding, gradients.fc1, gradients.fc1_bias);
    }
}
