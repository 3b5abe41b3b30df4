//! The attention hypernetwork: numbers for agents or teams from everything around them.
//!
//! Dissertation section 5.3.2 and the public code: embed every entity, let the agents attend, project
//! twice. No activation stands between the value matrix and the last layer, so that these three matrices
//! are one here, which is exact: they are merged before a step, and the gradient of the merged matrix is
//! handed back to the three after it. Numbers of a team are means over its agents; they are taken before
//! the merged matrix is applied.

use std::ops::Range;

use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use sortie_nn::layers::team_attention::{self, Backward, Forward, Sums, TeamLists};
use sortie_nn::layers::{SparseRows, relu, sparse_linear};

use crate::sized;

/// What a hypernetwork gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// M numbers for every agent.
    Matrix,
    /// M numbers for every team: the mean over its agents.
    Vector,
    /// One number for every team: the mean of its vector.
    Scalar,
}

impl Mode {
    fn sums(self) -> Sums {
        if self == Self::Matrix { Sums::PerQuery } else { Sums::PerTeam }
    }
}

/// Sizes of a hypernetwork.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HypernetworkShape {
    /// Input columns of one entity.
    pub input: usize,
    /// Width E of embedding and attention.
    pub width: usize,
    /// Attention heads H, a divisor of the width.
    pub heads: usize,
    /// Mixing width M.
    pub mixing: usize,
}

impl HypernetworkShape {
    fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    fn square(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    fn wide(self) -> usize {
        self.heads * self.width
    }

    /// Numbers K for each agent or team.
    fn outputs(self, mode: Mode) -> usize {
        if mode == Mode::Scalar { 1 } else { self.mixing }
    }

    /// The merged layer `[K, H E]`.
    fn merged(self, mode: Mode) -> LinearShape {
        LinearShape { input: self.wide(), output: self.outputs(mode) }
    }

    /// Names, inputs and lengths of all tensors, in the order of the flat parameter vector. `fc1.weight`
    /// is `[input, E]`, the other matrices are `[out, in]`.
    pub fn tensors(self) -> [(&'static str, usize, usize); 9] {
        let Self { input, width, mixing, .. } = self;
        let square = width * width;
        [
            ("fc1.weight", input, input * width),
            ("fc1.bias", input, width),
            ("attention.query.weight", width, square),
            ("attention.key.weight", width, square),
            ("attention.value.weight", width, square),
            ("attention.out.weight", width, square),
            ("attention.out.bias", width, width),
            ("fc2.weight", width, mixing * width),
            ("fc2.bias", width, mixing),
        ]
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.tensors().iter().map(|(.., length)| length).sum()
    }

    fn view(self, parameters: &[f32]) -> View<'_> {
        let mut rest = parameters;
        let [fc1, fc1_bias, query, key, value, out, out_bias, fc2, fc2_bias] =
            self.tensors().map(|(.., length)| rest.split_off(..length).expect("all tensors"));
        View { fc1, fc1_bias, query, key, value, out, out_bias, fc2, fc2_bias }
    }

    /// Where the gradients of a pass stand: the first four tensors, the merged matrix and its bias.
    fn pass_gradient(self, mode: Mode) -> [Range<usize>; 6] {
        let tensors = self.tensors();
        let outputs = self.outputs(mode);
        let mut start = 0;
        let first = [tensors[0].2, tensors[1].2, tensors[2].2, tensors[3].2];
        let [a, b, c, d] = first;
        [a, b, c, d, outputs * self.wide(), outputs].map(|length| {
            start += length;
            start - length..start
        })
    }
}

/// The tensors, borrowed.
struct View<'a> {
    fc1: &'a [f32],
    fc1_bias: &'a [f32],
    query: &'a [f32],
    key: &'a [f32],
    value: &'a [f32],
    out: &'a [f32],
    out_bias: &'a [f32],
    fc2: &'a [f32],
    fc2_bias: &'a [f32],
}

/// What a mixer looks at: the entities of any number of teams.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MixerInput {
    /// Features of every entity, those of the teams' agents first.
    pub rows: SparseRows,
    /// The teams, their agents being the queries, and what they attend to.
    pub teams: TeamLists,
}

/// Value, output and last matrix of a hypernetwork in one.
#[derive(Clone, Debug)]
pub struct Merged {
    /// The last layer `[K, E]` before it is merged.
    last: Vec<f32>,
    /// The last layer times the output projection, `[K, E]`.
    projected: Vec<f32>,
    /// `[K, H E]`
    weight: Vec<f32>,
    /// `[K]`
    bias: Vec<f32>,
}

impl Merged {
    /// Merges matrices of a parameter vector.
    pub fn new(shape: HypernetworkShape, mode: Mode, parameters: &[f32]) -> Self {
        let HypernetworkShape { width, heads, .. } = shape;
        let view = shape.view(parameters);
        let outputs = shape.outputs(mode);
        let (last, mut bias) = match mode {
            Mode::Scalar => {
                let share = 1.0 / shape.mixing as f32;
                let mut last = vec![0.0; width];
                linear::backward_bias(view.fc2, &mut last);
                last.iter_mut().for_each(|value| *value *= share);
                (last, vec![view.fc2_bias.iter().sum::<f32>() * share])
            }
            Mode::Matrix | Mode::Vector => (view.fc2.to_vec(), view.fc2_bias.to_vec()),
        };
        let mut projected = vec![0.0; outputs * width];
        multiply(
            MatrixMut::new(&mut projected, outputs, width),
            Store::Replace,
            Matrix::new(&last, outputs, width),
            Matrix::new(view.out, width, width),
        );
        for (bias, last) in bias.iter_mut().zip(last.chunks_exact(width)) {
            *bias += last.iter().zip(view.out_bias).map(|(w, b)| w * b).sum::<f32>();
        }
        let mut weight = vec![0.0; outputs * shape.wide()];
        for head in 0..heads {
            let (narrow, broad) = head_columns(shape, head);
            multiply(
                MatrixMut::new(&mut weight, outputs, shape.wide()).columns(broad),
                Store::Replace,
                Matrix::new(&projected, outputs, width).columns(narrow),
                head_rows(shape, head, view.value),
            );
        }
        Self { last, projected, weight, bias }
    }
}

/// Columns of a head in `[.., E]` and in `[.., H E]`.
fn head_columns(shape: HypernetworkShape, head: usize) -> (Range<usize>, Range<usize>) {
    let (width, narrow) = (shape.width, shape.width / shape.heads);
    (head * narrow..(head + 1) * narrow, head * width..(head + 1) * width)
}

/// The value matrix `[E / H, E]` of a head.
fn head_rows(shape: HypernetworkShape, head: usize, value: &[f32]) -> Matrix<'_> {
    let (width, narrow) = (shape.width, shape.width / shape.heads);
    Matrix::new(&value[head * narrow * width..][..narrow * width], narrow, width)
}

/// The gradient of one hypernetwork as passes add to it, before it is handed to all tensors.
#[derive(Clone, Debug)]
pub struct HypernetworkGradient {
    shape: HypernetworkShape,
    mode: Mode,
    values: Vec<f32>,
}

impl HypernetworkGradient {
    /// Zeros.
    pub fn new(shape: HypernetworkShape, mode: Mode) -> Self {
        let length = shape.pass_gradient(mode)[5].end;
        Self { shape, mode, values: vec![0.0; length] }
    }

    /// Sets all to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds another gradient of the same hypernetwork.
    pub fn add(&mut self, other: &Self) {
        for (sum, value) in self.values.iter_mut().zip(&other.values) {
            *sum += value;
        }
    }

    /// Writes the gradient of all tensors, in the order of [`HypernetworkShape::tensors`].
    pub fn write(&self, parameters: &[f32], merged: &Merged, gradient: &mut [f32]) {
        let Self { shape, mode, values } = self;
        let HypernetworkShape { width, heads, mixing, .. } = *shape;
        let view = shape.view(parameters);
        let outputs = shape.outputs(*mode);
        let places = shape.pass_gradient(*mode);
        let (d_merged, d_bias) = (&values[places[4].clone()], &values[places[5].clone()]);

        let mut rest = gradient;
        let mut take = |length: usize| rest.split_off_mut(..length).expect("all tensors");
        let first = places[3].end;
        take(first).copy_from_slice(&values[..first]);
        let [value, out, out_bias, fc2, fc2_bias] =
            [4, 5, 6, 7, 8].map(|place| take(shape.tensors()[place].2));

        let mut d_projected = vec![0.0; outputs * width];
        for head in 0..heads {
            let (narrow, broad) = head_columns(*shape, head);
            let d_merged = Matrix::new(d_merged, outputs, shape.wide()).columns(broad);
            multiply(
                MatrixMut::new(&mut value[narrow.start * width..], narrow.len(), width),
                Store::Replace,
                Matrix::new(&merged.projected, outputs, width).columns(narrow.clone()).transposed(),
                d_merged,
            );
            multiply(
                MatrixMut::new(&mut d_projected, outputs, width).columns(narrow),
                Store::Replace,
                d_merged,
                head_rows(*shape, head, view.value).transposed(),
            );
        }
        let last = Matrix::new(&merged.last, outputs, width);
        let d_projected = Matrix::new(&d_projected, outputs, width);
        multiply(MatrixMut::new(out, width, width), Store::Replace, last.transposed(), d_projected);
        multiply(
            MatrixMut::new(out_bias, 1, width),
            Store::Replace,
            Matrix::new(d_bias, 1, outputs),
            last,
        );
        multiply(
            MatrixMut::new(&mut fc2[..outputs * width], outputs, width),
            Store::Replace,
            d_projected,
            Matrix::new(view.out, width, width).transposed(),
        );
        for (d_last, d_bias) in fc2.chunks_exact_mut(width).zip(d_bias) {
            for (d_last, out_bias) in d_last.iter_mut().zip(view.out_bias) {
                *d_last += d_bias * out_bias;
            }
        }
        fc2_bias[..outputs].copy_from_slice(d_bias);
        if *mode == Mode::Scalar {
            let share = 1.0 / mixing as f32;
            fc2[..width].iter_mut().for_each(|slope| *slope *= share);
            (1..mixing).for_each(|row| fc2.copy_within(..width, row * width));
            fc2_bias.fill(d_bias[0] * share);
        }
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct HypernetworkPass {
    embedding: Vec<f32>,
    queries: Vec<f32>,
    keys: Vec<f32>,
    weights: Vec<f32>,
    sums: Vec<f32>,
    numbers: Vec<f32>,
    d_sums: Vec<f32>,
    d_queries: Vec<f32>,
    d_keys: Vec<f32>,
    d_embedding: Vec<f32>,
    operations: u64,
}

impl HypernetworkPass {
    /// Floating-point operations of all passes up to now: those of matrix products, sparse ones and
    /// attention, a multiplication and an addition being two.
    pub fn operations(&self) -> u64 {
        self.operations
    }

    /// Multiplications of a forward pass: in the first layer, and in all others.
    fn multiplications(shape: HypernetworkShape, mode: Mode, input: &MixerInput) -> (u64, u64) {
        let (rows, teams) = (&input.rows, &input.teams);
        let count = mode.sums().count(teams);
        let summed = if mode == Mode::Matrix { teams.pairs() } else { teams.members() };
        let queries = teams.queries() + rows.len();
        let rest = queries * shape.width * shape.width
            + teams.pairs() * shape.width
            + summed * shape.wide()
            + count * shape.wide() * shape.outputs(mode);
        ((rows.entries() * shape.width) as u64, rest as u64)
    }

    /// Computes the numbers `[agents or teams, K]`, where means are over `slots` agents: absent ones count
    /// as zeros.
    pub fn forward(
        &mut self,
        (shape, mode, slots): (HypernetworkShape, Mode, usize),
        parameters: &[f32],
        merged: &Merged,
        input: &MixerInput,
    ) -> &[f32] {
        let (first, rest) = Self::multiplications(shape, mode, input);
        self.operations += 2 * (first + rest);
        let width = shape.width;
        let teams = &input.teams;
        let (rows, queries) = (input.rows.len(), teams.queries());
        let view = shape.view(parameters);
        let embedding = sized(&mut self.embedding, rows * width);
        sparse_linear::forward(&input.rows, view.fc1, view.fc1_bias, embedding);
        relu::forward(embedding);
        let own = &embedding[..queries * width];
        let query = sized(&mut self.queries, queries * width);
        linear::forward_without_bias(shape.square(), own, view.query, query);
        let keys = sized(&mut self.keys, rows * width);
        linear::forward_without_bias(shape.square(), embedding, view.key, keys);

        let count = mode.sums().count(teams);
        let weights = sized(&mut self.weights, teams.pairs() * shape.heads);
        let sums = sized(&mut self.sums, count * shape.wide());
        let pass = Forward { queries: query, keys, rows: embedding, weights, sums };
        team_attention::forward(shape.attention(), teams, mode.sums(), pass);
        let numbers = sized(&mut self.numbers, count * shape.outputs(mode));
        linear::forward_without_bias(shape.merged(mode), sums, &merged.weight, numbers);
        add_biases(mode, slots, teams, &merged.bias, numbers);
        numbers
    }

    /// Adds to `gradient` that of a loss whose slope by the numbers of the last forward pass is
    /// `d_numbers`, which is scaled in place.
    pub fn backward(
        &mut self,
        (shape, mode, slots): (HypernetworkShape, Mode, usize),
        parameters: &[f32],
        merged: &Merged,
        input: &MixerInput,
        d_numbers: &mut [f32],
        gradient: &mut HypernetworkGradient,
    ) {
        let (first, rest) = Self::multiplications(shape, mode, input);
        self.operations += 2 * (first + 2 * rest);
        let width = shape.width;
        let teams = &input.teams;
        let (rows, queries) = (input.rows.len(), teams.queries());
        let view = shape.view(parameters);
        let mut rest = &mut *gradient.values;
        let [fc1, fc1_bias, query, key, d_weight, d_bias] = shape
            .pass_gradient(mode)
            .map(|range| rest.split_off_mut(..range.len()).expect("all tensors"));

        descend_biases(mode, slots, teams, d_numbers, d_bias);
        let count = mode.sums().count(teams);
        let sums = &self.sums[..count * shape.wide()];
        linear::backward_weight(shape.merged(mode), sums, d_numbers, d_weight);
        let d_sums = sized(&mut self.d_sums, count * shape.wide());
        linear::backward_input(
            shape.merged(mode),
            d_numbers,
            &merged.weight,
            Store::Replace,
            d_sums,
        );
        let embedding = &self.embedding[..rows * width];
        let d_queries = sized(&mut self.d_queries, queries * width);
        let d_keys = sized(&mut self.d_keys, rows * width);
        let d_embedding = sized(&mut self.d_embedding, rows * width);
        let pass = Backward {
            queries: &self.queries,
            keys: &self.keys,
            rows: embedding,
            weights: &self.weights[..teams.pairs() * shape.heads],
            d_sums,
            d_queries: &mut *d_queries,
            d_keys: &mut *d_keys,
            d_rows: &mut *d_embedding,
        };
        team_attention::backward(shape.attention(), teams, mode.sums(), pass);

        let own = queries * width;
        linear::backward_weight(shape.square(), &embedding[..own], d_queries, query);
        linear::backward_weight(shape.square(), embedding, d_keys, key);
        let d_own = &mut d_embedding[..own];
        linear::backward_input(shape.square(), d_queries, view.query, Store::Add, d_own);
        linear::backward_input(shape.square(), d_keys, view.key, Store::Add, d_embedding);
        relu::backward(embedding, d_embedding);
        sparse_linear::backward(&input.rows, d_embedding, fc1, fc1_bias);
    }
}

/// Adds the bias to every agent's numbers, or makes sums over a team's agents means and adds the bias as
/// often as the team has agents.
fn add_biases(mode: Mode, slots: usize, teams: &TeamLists, bias: &[f32], numbers: &mut [f32]) {
    if mode == Mode::Matrix {
        for row in numbers.chunks_exact_mut(bias.len()) {
            row.iter_mut().zip(bias).for_each(|(number, bias)| *number += bias);
        }
        return;
    }
    let share = 1.0 / slots as f32;
    for (row, size) in numbers.chunks_exact_mut(bias.len()).zip(teams.sizes()) {
        for (number, bias) in row.iter_mut().zip(bias) {
            *number = share * (*number + size as f32 * bias);
        }
    }
}

/// Goes back through [`add_biases`]: scales the gradient of the numbers, adds to that of the bias.
fn descend_biases(
    mode: Mode,
    slots: usize,
    teams: &TeamLists,
    d_numbers: &mut [f32],
    d_bias: &mut [f32],
) {
    if mode == Mode::Matrix {
        linear::backward_bias(d_numbers, d_bias);
        return;
    }
    let share = 1.0 / slots as f32;
    for (row, size) in d_numbers.chunks_exact_mut(d_bias.len()).zip(teams.sizes()) {
        for (slope, d_bias) in row.iter_mut().zip(d_bias.iter_mut()) {
            *slope *= share;
            *d_bias += size as f32 * *slope;
        }
    }
}
