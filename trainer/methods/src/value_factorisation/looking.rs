//! Entities embedded and looked at: what agents and hypernetworks begin with. Where few rows make many pairs, attention
//! looks its scores up in those of rows by rows.

use std::ops::Range;

use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use sortie_nn::layers::{SparseRows, relu, sparse_linear};
use sortie_nn::random::{Generator, signed_unit};

use super::split_attention::{self, Asking, Backward, ByRows, Forward, HEADS, SplitLists};
use crate::sized;

/// What is looked at, and by whom.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    /// Features of entities.
    pub(super) rows: &'a SparseRows,
    /// The row of every query, where rows are shared; else query i belongs to row i.
    pub(super) own: &'a [u32],
    /// For each query the rows that it sees.
    pub(super) lists: &'a SplitLists,
}

impl View<'_> {
    /// Rows that queries are made of, which come first.
    fn asking_rows(self) -> usize {
        if self.own.is_empty() { self.lists.queries() } else { self.rows.len() }
    }

    /// Whether scores are taken of rows by rows, which are fewer than the pairs that are looked at.
    pub(super) fn is_by_rows(self) -> bool {
        !self.own.is_empty() && self.rows.len().pow(2) <= 2 * self.lists.pairs()
    }

    /// Numbers of what scores are made of.
    fn asked(self, width: usize) -> usize {
        let rows = self.rows.len();
        if self.is_by_rows() { HEADS * rows * rows } else { self.lists.queries() * width }
    }

    fn asking<'a>(&'a self, asked: &'a [f32]) -> Asking<'a> {
        if self.is_by_rows() {
            Asking::Rows(ByRows { scores: asked, own: self.own, rows: self.rows.len() })
        } else {
            Asking::Queries(asked)
        }
    }
}

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
    /// Of the rows, where they are shared.
    row_queries: Vec<f32>,
    /// Queries, or scores of rows by rows.
    asked: Vec<f32>,
    keys_values: Vec<f32>,
    weights: Vec<f32>,
    shares: Vec<f32>,
    attended: Vec<f32>,
    own: Vec<f32>,
    d_embedding: Vec<f32>,
    d_row_queries: Vec<f32>,
    d_asked: Vec<f32>,
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
        view: View<'_>,
        blocks: usize,
    ) -> &[f32] {
        let View { rows, own, lists } = view;
        let agents = lists.queries();
        let embedding = sized(&mut self.embedding, rows.len() * width);
        sparse_linear::forward(rows, weights.fc1, weights.fc1_bias, embedding);
        relu::forward(embedding);
        let (to_queries, to_keys_values) = weights.attention_in.split_at(width * width);
        let asking = &embedding[..view.asking_rows() * width];
        let keys_values = sized(&mut self.keys_values, rows.len() * 2 * width);
        linear::forward_without_bias(keys_values_of(width), embedding, to_keys_values, keys_values);
        let asked = sized(&mut self.asked, view.asked(width));
        if own.is_empty() {
            linear::forward_without_bias(square(width), asking, to_queries, asked);
        } else {
            let of_rows = sized(&mut self.row_queries, asking.len());
            linear::forward_without_bias(square(width), asking, to_queries, of_rows);
            if view.is_by_rows() {
                forward(width, of_rows, keys_values, asked);
            } else {
                gather(width, own, of_rows, asked);
            }
        }
        let output = sized(&mut self.attended, blocks * agents * width);
        let pass = Forward {
            asking: view.asking(asked),
            keys_values,
            weights: sized(&mut self.weights, lists.pairs() * HEADS),
            shares: sized(&mut self.shares, agents * HEADS),
            output,
        };
        split_attention::forward(width, lists, pass);
        output
    }

    /// The agents' own embeddings `[agents, E]` in the last forward pass, which looked at this.
    pub(super) fn own(&mut self, width: usize, view: View<'_>) -> &[f32] {
        if view.own.is_empty() {
            return &self.embedding[..view.lists.queries() * width];
        }
        let own = sized(&mut self.own, view.own.len() * width);
        gather(width, view.own, &self.embedding, own);
        own
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
        view: View<'_>,
        d_attended: &[f32],
        d_own: Option<&[f32]>,
        gradients: Gradients<'_>,
    ) {
        let View { rows, own, lists } = view;
        let agents = lists.queries();
        let d_asked = sized(&mut self.d_asked, view.asked(width));
        let keys_values = &self.keys_values[..rows.len() * 2 * width];
        let d_keys_values = sized(&mut self.d_keys_values, keys_values.len());
        let pass = Backward {
            asking: view.asking(&self.asked[..view.asked(width)]),
            keys_values,
            weights: &self.weights[..lists.pairs() * HEADS],
            shares: &self.shares[..agents * HEADS],
            output: &self.attended[..d_attended.len()],
            d_output: d_attended,
            d_scores: sized(&mut self.d_scores, lists.pairs() * HEADS),
            d_asking: d_asked,
            d_keys_values,
        };
        split_attention::backward(width, lists, pass);

        let asking = view.asking_rows() * width;
        let mut d_queries: &[f32] = d_asked;
        if !own.is_empty() {
            let of_rows = sized(&mut self.d_row_queries, asking);
            if view.is_by_rows() {
                let queries = &self.row_queries[..asking];
                backward(width, (queries, keys_values), d_asked, (of_rows, d_keys_values));
            } else {
                of_rows.fill(0.0);
                scatter(width, own, d_asked, of_rows);
            }
            d_queries = of_rows;
        }
        let embedding = &self.embedding[..rows.len() * width];
        let d_embedding = sized(&mut self.d_embedding, rows.len() * width);
        let (to_queries, to_keys_values) = weights.attention_in.split_at(width * width);
        let (d_to_queries, d_to_keys_values) = gradients.attention_in.split_at_mut(width * width);
        let shape = keys_values_of(width);
        linear::backward_weight(shape, embedding, d_keys_values, d_to_keys_values);
        linear::backward_input(shape, d_keys_values, to_keys_values, Store::Replace, d_embedding);
        let (embedding_of, d_embedding_of) = (&embedding[..asking], &mut d_embedding[..asking]);
        linear::backward_weight(square(width), embedding_of, d_queries, d_to_queries);
        linear::backward_input(square(width), d_queries, to_queries, Store::Add, d_embedding_of);
        if let Some(d_own) = d_own {
            if own.is_empty() {
                d_embedding.iter_mut().zip(d_own).for_each(|(slope, own)| *slope += own);
            } else {
                scatter(width, own, d_own, d_embedding);
            }
        }
        relu::backward(embedding, d_embedding);
        sparse_linear::backward(rows, d_embedding, gradients.fc1, gradients.fc1_bias);
    }
}

/// Copies the row of every query.
fn gather(width: usize, own: &[u32], rows: &[f32], out: &mut [f32]) {
    for (out, row) in out.chunks_exact_mut(width).zip(own) {
        out.copy_from_slice(&rows[*row as usize * width..][..width]);
    }
}

/// Adds what every query has to its row.
fn scatter(width: usize, own: &[u32], values: &[f32], rows: &mut [f32]) {
    for (values, row) in values.chunks_exact(width).zip(own) {
        let row = &mut rows[*row as usize * width..][..width];
        row.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
}

fn heads(width: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    let head = width / HEADS;
    (0..HEADS).map(move |index| index * head..(index + 1) * head)
}

fn scale(width: usize) -> f32 {
    1.0 / ((width / HEADS) as f32).sqrt()
}

/// Writes the scores `[heads, rows, rows]` of queries `[rows, width]`, which are scaled by it, and of keys in
/// `[rows, 2 * width]`, each with a value behind it.
pub(super) fn forward(width: usize, queries: &mut [f32], keys_values: &[f32], scores: &mut [f32]) {
    let rows = queries.len() / width;
    let scale = scale(width);
    queries.iter_mut().for_each(|query| *query *= scale);
    let queries = Matrix::new(queries, rows, width);
    let keys = Matrix::new(keys_values, rows, 2 * width);
    for (head, scores) in heads(width).zip(scores.chunks_exact_mut((rows * rows).max(1))) {
        multiply(
            MatrixMut::new(scores, rows, rows),
            Store::Replace,
            queries.columns(head.clone()),
            keys.columns(head).transposed(),
        );
    }
}

/// Writes the slopes by queries, before they were scaled, and by keys.
pub(super) fn backward(
    width: usize,
    (queries, keys_values): (&[f32], &[f32]),
    d_scores: &[f32],
    (d_queries, d_keys_values): (&mut [f32], &mut [f32]),
) {
    let rows = queries.len() / width;
    let queries = Matrix::new(queries, rows, width);
    let keys = Matrix::new(keys_values, rows, 2 * width);
    for (head, d_scores) in heads(width).zip(d_scores.chunks_exact((rows * rows).max(1))) {
        let d_scores = Matrix::new(d_scores, rows, rows);
        let out = MatrixMut::new(d_queries, rows, width).columns(head.clone());
        multiply(out, Store::Replace, d_scores, keys.columns(head.clone()));
        let out = MatrixMut::new(d_keys_values, rows, 2 * width).columns(head.clone());
        multiply(out, Store::Replace, d_scores.transposed(), queries.columns(head));
    }
    let scale = scale(width);
    d_queries.iter_mut().for_each(|slope| *slope *= scale);
}

/// One tensor and its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tensor {
    /// Its name in files.
    pub name: String,
    /// Inputs of its layer, by which its first weights are scaled.
    pub inputs: usize,
    /// Its place in the vector.
    pub range: Range<usize>,
}

impl Tensor {
    /// The same as checkpoints name it.
    pub(super) fn saved(&self) -> sortie_learn::state::Tensor {
        let Self { name, range, .. } = self;
        sortie_learn::state::Tensor {
            name: name.clone(),
            shape: vec![range.len()],
            range: range.clone(),
        }
    }
}

/// Places tensors `(name, inputs, numbers)` one behind the other.
pub(super) fn place(start: usize, prefix: &str, tensors: &[(&str, usize, usize)]) -> Vec<Tensor> {
    let mut end = start;
    let next = |&(name, inputs, numbers): &(&str, usize, usize)| {
        let range = end..end + numbers;
        end = range.end;
        Tensor { name: format!("{prefix}.{name}"), inputs, range }
    };
    tensors.iter().map(next).collect()
}

/// Cuts a vector into the tensors' parts.
pub(super) fn views<const COUNT: usize>(
    vector: &[f32],
    numbers: [usize; COUNT],
) -> [&[f32]; COUNT] {
    let mut rest = vector;
    numbers.map(|count| rest.split_off(..count).expect("one place per parameter"))
}

/// As [`views`], to be changed.
pub(super) fn views_mut<const COUNT: usize>(
    vector: &mut [f32],
    numbers: [usize; COUNT],
) -> [&mut [f32]; COUNT] {
    let mut rest = vector;
    numbers.map(|count| rest.split_off_mut(..count).expect("one place per parameter"))
}

/// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
pub(super) fn initialise(tensors: &[Tensor], parameters: &mut [f32], generator: &mut Generator) {
    for tensor in tensors {
        let bound = 1.0 / (tensor.inputs as f32).sqrt();
        parameters[tensor.range.clone()]
            .iter_mut()
            .for_each(|value| *value = bound * signed_unit(generator));
    }
}
