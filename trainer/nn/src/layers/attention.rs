//! Masked multi-head attention over ragged lists: each query attends to the entities that it sees.
//!
//! Dissertation section 2.3 and the public code's entity attention layer, between its two projections:
//! scores `q . k / sqrt(head width)`, softmax over the visible entities only, weighted sum of values.
//! A query that sees nothing gets a zero vector. Invisible entities are never touched, which is exact
//! because their weight is zero.
//!
//! All that attention does with the rows of a list are three things, which go back through each other: the
//! products of a vector with each row are scores and, of slopes by the output, slopes by the weights;
//! weighted sums of rows are outputs and slopes by the query; and multiples of a vector
//! are what each row gets for its slopes.

use std::ops::Range;

use sortie_core::internal::math::exp;

use super::lists::VisibleLists;
use super::vectors::{add_scaled, add_weighted_sum, dots, run_widest, run_with_width};

/// Sizes of an attention layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttentionShape {
    /// Width of queries, keys and values.
    pub width: usize,
    /// Number of heads, a divisor of the width.
    pub heads: usize,
}

impl AttentionShape {
    #[inline(always)]
    pub(super) fn head_width(self) -> usize {
        self.width / self.heads
    }

    #[inline(always)]
    pub(super) fn scale(self) -> f32 {
        1.0 / (self.head_width() as f32).sqrt()
    }
}

/// Runs a pass, which is to be `#[inline(always)]`, in the widest build, usual sizes as constants.
pub(super) fn run_with_shape(shape: AttentionShape, pass: impl FnOnce(AttentionShape)) {
    if shape.heads == 4 {
        run_with_width(
            shape.width,
            #[inline(always)]
            |width| pass(AttentionShape { width, heads: 4 }),
        );
    } else {
        run_widest(
            #[inline(always)]
            || pass(shape),
        );
    }
}

/// Some rows of a matrix, of which a vector each is looked at. The vectors that are joined with them have a part for each head,
/// one behind the other. A row's vector that is as wide as such a part is whole for every head; another has parts as well.
#[derive(Clone, Copy)]
pub(super) struct List<'a> {
    rows: &'a [u32],
    heads: usize,
    /// Numbers of a row of the matrix.
    stride: usize,
    /// The first column of its vector.
    first: usize,
    /// Numbers of its vector.
    width: usize,
}

impl<'a> List<'a> {
    /// Rows of a matrix that is so wide.
    #[inline(always)]
    pub(super) fn whole(rows: &'a [u32], AttentionShape { width, heads }: AttentionShape) -> Self {
        Self { rows, heads, stride: width, first: 0, width }
    }

    /// Keys and values `[rows, 2 * width]`, a key and then a value in every row.
    #[inline(always)]
    fn in_pairs(rows: &'a [u32], AttentionShape { width, heads }: AttentionShape) -> [Self; 2] {
        [0, width].map(|first| Self { rows, heads, stride: 2 * width, first, width })
    }

    #[inline(always)]
    fn place(self, row: u32) -> Range<usize> {
        let start = row as usize * self.stride + self.first;
        start..start + self.width
    }

    /// How wide the parts of a vector are, and how far they are from each other in a row.
    #[inline(always)]
    fn parts(self, vector: &[f32]) -> (usize, usize) {
        let part = vector.len() / self.heads;
        (part, if part == self.width { 0 } else { part })
    }

    /// Writes `[list, heads]` the products of a vector and each row.
    #[inline(always)]
    pub(super) fn products(self, matrix: &[f32], vector: &[f32], products: &mut [f32]) {
        for (row, products) in self.rows.iter().zip(products.chunks_exact_mut(self.heads)) {
            dots(vector, &matrix[self.place(*row)], products);
        }
    }

    /// Writes the sum of the rows, weighted by `weights [list, heads]`.
    #[inline(always)]
    pub(super) fn sum(self, matrix: &[f32], weights: &[f32], sum: &mut [f32]) {
        let (part, step) = self.parts(sum);
        for (head, sum) in sum.chunks_exact_mut(part).enumerate() {
            let rows = self.rows.iter().zip(weights.chunks_exact(self.heads));
            let terms = rows.map(|(row, weights)| {
                (weights[head], &matrix[self.place(*row)][head * step..][..part])
            });
            sum.fill(0.0);
            add_weighted_sum(sum, terms);
        }
    }

    /// Adds to each row a vector times its factor of `factors [list, heads]`.
    #[inline(always)]
    pub(super) fn add_multiples(self, matrix: &mut [f32], factors: &[f32], vector: &[f32]) {
        let (part, step) = self.parts(vector);
        for (row, factors) in self.rows.iter().zip(factors.chunks_exact(self.heads)) {
            let row = &mut matrix[self.place(*row)];
            if step == 0 {
                let terms = factors.iter().copied().zip(vector.chunks_exact(part));
                add_weighted_sum(row, terms);
                continue;
            }
            let parts = vector.chunks_exact(part).zip(row.chunks_exact_mut(part));
            for (factor, (vector, row)) in factors.iter().zip(parts) {
                add_scaled(row, *factor, vector);
            }
        }
    }

    /// Writes the attention weights `[list, heads]` of a query, whose scores are scaled so.
    #[inline(always)]
    pub(super) fn weigh(self, keys: &[f32], query: &[f32], scale: f32, weights: &mut [f32]) {
        self.products(keys, query, weights);
        weights.iter_mut().for_each(|score| *score *= scale);
        softmax_columns(weights, self.heads);
    }
}

/// The tensors of a forward pass.
#[derive(Debug)]
pub struct Forward<'a> {
    /// Queries `[queries, width]`.
    pub queries: &'a [f32],
    /// `[rows, 2 * width]`: each row's key, then its value.
    pub keys_values: &'a [f32],
    /// `[pairs, heads]`: attention weights, or scores; written.
    pub of_pairs: &'a mut [f32],
    /// What attention to [parts](super::split_attention) keeps besides, `[queries, heads]`; written.
    pub shares: &'a mut [f32],
    /// What the queries get; written.
    pub output: &'a mut [f32],
}

/// The tensors of a backward pass.
#[derive(Debug)]
pub struct Backward<'a> {
    /// As in the forward pass.
    pub queries: &'a [f32],
    /// As in the forward pass.
    pub keys_values: &'a [f32],
    /// What the forward pass wrote.
    pub of_pairs: &'a [f32],
    /// What the forward pass wrote.
    pub shares: &'a [f32],
    /// What the forward pass wrote.
    pub output: &'a [f32],
    /// Gradient of the output.
    pub d_output: &'a [f32],
    /// Space for `[pairs, heads]` numbers.
    pub d_scores: &'a mut [f32],
    /// Gradient of the queries `[queries, width]`, overwritten.
    pub d_queries: &'a mut [f32],
    /// Gradient of keys and values `[rows, 2 * width]`, overwritten.
    pub d_keys_values: &'a mut [f32],
}

/// Writes the attention weights and the output `[queries, width]`.
pub fn forward(shape: AttentionShape, visible: &VisibleLists, pass: Forward<'_>) {
    let AttentionShape { width, heads } = shape;
    run_widest(
        #[inline(always)]
        || {
            for (index, output) in pass.output.chunks_exact_mut(width).enumerate() {
                let (start, rows) = visible.span(index);
                let weights = &mut pass.of_pairs[start * heads..][..rows.len() * heads];
                let [keys, values] = List::in_pairs(rows, shape);
                let query = &pass.queries[index * width..][..width];
                keys.weigh(pass.keys_values, query, shape.scale(), weights);
                values.sum(pass.keys_values, weights, output);
            }
        },
    );
}

/// Writes the gradients of queries, keys and values.
pub fn backward(shape: AttentionShape, visible: &VisibleLists, pass: Backward<'_>) {
    let AttentionShape { width, heads } = shape;
    run_widest(
        #[inline(always)]
        || {
            pass.d_keys_values.fill(0.0);
            for index in 0..visible.queries() {
                let (start, rows) = visible.span(index);
                let own = index * width..(index + 1) * width;
                let d_output = &pass.d_output[own.clone()];
                let weights = &pass.of_pairs[start * heads..][..rows.len() * heads];
                let d_scores = &mut pass.d_scores[..rows.len() * heads];
                let [keys, values] = List::in_pairs(rows, shape);
                values.products(pass.keys_values, d_output, d_scores);
                values.add_multiples(pass.d_keys_values, weights, d_output);
                softmax_columns_backward(weights, d_scores, heads);
                d_scores.iter_mut().for_each(|d_score| *d_score *= shape.scale());
                keys.sum(pass.keys_values, d_scores, &mut pass.d_queries[own.clone()]);
                keys.add_multiples(pass.d_keys_values, d_scores, &pass.queries[own]);
            }
        },
    );
}

/// Writes the scores, `q . k` before they are scaled, and as output `[queries]` the sum of their squares over all heads and
/// all that each query sees: what a penalty keeps small. Dissertation chapter 3, public code: their mean joins the critic's
/// loss.
pub(crate) fn squared_scores(shape: AttentionShape, visible: &VisibleLists, pass: Forward<'_>) {
    let AttentionShape { width, heads } = shape;
    run_widest(
        #[inline(always)]
        || {
            for (index, sum) in pass.output.iter_mut().enumerate() {
                let (start, rows) = visible.span(index);
                let scores = &mut pass.of_pairs[start * heads..][..rows.len() * heads];
                let [keys, _] = List::in_pairs(rows, shape);
                keys.products(pass.keys_values, &pass.queries[index * width..][..width], scores);
                *sum = 0.0;
                for scores in scores.chunks_exact(heads) {
                    *sum += scores.iter().map(|score| score * score).sum::<f32>();
                }
            }
        },
    );
}

/// Writes the gradients of queries and keys, and zeros for values.
pub(crate) fn squared_scores_backward(
    shape: AttentionShape,
    visible: &VisibleLists,
    pass: Backward<'_>,
) {
    let AttentionShape { width, heads } = shape;
    run_widest(
        #[inline(always)]
        || {
            pass.d_keys_values.fill(0.0);
            for (index, d_sum) in pass.d_output.iter().enumerate() {
                let (start, rows) = visible.span(index);
                let own = index * width..(index + 1) * width;
                let scores = &pass.of_pairs[start * heads..][..rows.len() * heads];
                let d_scores = &mut pass.d_scores[..scores.len()];
                let slopes = d_scores.iter_mut().zip(scores);
                slopes.for_each(|(slope, score)| *slope = 2.0 * d_sum * score);
                let [keys, _] = List::in_pairs(rows, shape);
                keys.sum(pass.keys_values, d_scores, &mut pass.d_queries[own.clone()]);
                keys.add_multiples(pass.d_keys_values, d_scores, &pass.queries[own]);
            }
        },
    );
}

/// Most heads.
const HEADS: usize = 64;

/// Softmax down each column of `scores [list, heads]`, in place. An empty list stays empty.
#[inline(always)]
pub(super) fn softmax_columns(scores: &mut [f32], heads: usize) {
    let (mut largest, mut sums) = ([f32::NEG_INFINITY; HEADS], [0.0; HEADS]);
    let (largest, sums) = (&mut largest[..heads], &mut sums[..heads]);
    for scores in scores.chunks_exact(heads) {
        for (largest, score) in largest.iter_mut().zip(scores) {
            *largest = if *score > *largest { *score } else { *largest };
        }
    }
    for scores in scores.chunks_exact_mut(heads) {
        for ((score, largest), sum) in scores.iter_mut().zip(&*largest).zip(&mut *sums) {
            *score = exp(*score - largest);
            *sum += *score;
        }
    }
    sums.iter_mut().for_each(|sum| *sum = 1.0 / *sum);
    for weights in scores.chunks_exact_mut(heads) {
        weights.iter_mut().zip(&*sums).for_each(|(weight, share)| *weight *= share);
    }
}

/// Turns gradients of the weights into gradients of the scores: `p * (d - sum(p * d))`.
#[inline(always)]
pub(super) fn softmax_columns_backward(weights: &[f32], gradient: &mut [f32], heads: usize) {
    let mut sums = [0.0; HEADS];
    let sums = &mut sums[..heads];
    for (weights, slopes) in weights.chunks_exact(heads).zip(gradient.chunks_exact(heads)) {
        for ((sum, p), d) in sums.iter_mut().zip(weights).zip(slopes) {
            *sum += p * d;
        }
    }
    for (weights, slopes) in weights.chunks_exact(heads).zip(gradient.chunks_exact_mut(heads)) {
        for ((sum, p), d) in sums.iter().zip(weights).zip(slopes) {
            *d = p * (*d - sum);
        }
    }
}

#[cfg(test)]
mod tests;
