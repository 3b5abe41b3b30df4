//! Masked multi-head attention over ragged lists: each query attends to the entities that it sees.
//!
//! Dissertation section 2.3 and the public code's entity attention layer, between its two projections:
//! scores `q . k / sqrt(head width)`, softmax over the visible entities only, weighted sum of values.
//! A query that sees nothing gets a zero vector. Invisible entities are never touched, which is exact
//! because their weight is zero.

use std::ops::Range;

use super::wide::{Work, run_widest};
use sortie_core::internal::math::exp;

use super::vectors::{add_scaled, dots, weighted_sum};

/// For each query the rows that it sees. A partition may split them into those within a part of it, which come first, and
/// those across; without one all are within.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleLists {
    /// Query i sees `rows[ends[i] .. ends[i + 1]]`; the first end is 0.
    ends: Vec<u32>,
    /// Where in `rows` the rows across begin, per query.
    splits: Vec<u32>,
    rows: Vec<u32>,
}

impl Default for VisibleLists {
    fn default() -> Self {
        Self { ends: vec![0], splits: Vec::new(), rows: Vec::new() }
    }
}

impl VisibleLists {
    /// Forgets all lists, keeps the memory.
    #[inline]
    pub fn clear(&mut self) {
        self.ends.truncate(1);
        self.splits.clear();
        self.rows.clear();
    }

    /// Becomes a copy of others, keeps the memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.ends.clone_from(&other.ends);
        self.splits.clone_from(&other.splits);
        self.rows.clone_from(&other.rows);
    }

    /// Adds a row to the list that the next [`end_list`](Self::end_list) closes.
    #[inline]
    pub fn push(&mut self, row: usize) {
        self.rows.push(row as u32);
    }

    /// Closes the list of one query.
    #[inline]
    pub fn end_list(&mut self) {
        self.splits.push(self.rows.len() as u32);
        self.ends.push(self.rows.len() as u32);
    }

    /// Adds the list of one query: rows within its part, and across.
    pub fn push_parts(
        &mut self,
        within: impl Iterator<Item = usize>,
        across: impl Iterator<Item = usize>,
    ) {
        self.rows.extend(within.map(|row| row as u32));
        self.splits.push(self.rows.len() as u32);
        self.rows.extend(across.map(|row| row as u32));
        self.ends.push(self.rows.len() as u32);
    }

    /// Number of queries.
    #[inline]
    pub fn queries(&self) -> usize {
        self.splits.len()
    }

    /// Total length of all lists.
    #[inline]
    pub fn pairs(&self) -> usize {
        self.rows.len()
    }

    /// The rows that a query sees.
    #[inline]
    pub fn list(&self, query: usize) -> impl Iterator<Item = usize> + '_ {
        self.span(query).1.iter().map(|row| *row as usize)
    }

    /// Where a query's pairs begin, and its rows.
    #[inline]
    pub(crate) fn span(&self, query: usize) -> (usize, &[u32]) {
        let (start, end) = (self.ends[query] as usize, self.ends[query + 1] as usize);
        (start, &self.rows[start..end])
    }

    /// The rows of all lists.
    #[inline(always)]
    pub(super) fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// The pairs of every query, and how many of them lie within.
    #[inline(always)]
    pub(super) fn spans(&self) -> impl Iterator<Item = (Range<usize>, usize)> {
        let ends = self.ends.windows(2).map(|ends| ends[0] as usize..ends[1] as usize);
        ends.zip(&self.splits).map(|(pairs, split)| {
            let within = *split as usize - pairs.start;
            (pairs, within)
        })
    }
}

/// Sizes of an attention layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttentionShape {
    /// Width of queries, keys and values.
    pub width: usize,
    /// Number of heads, a divisor of the width.
    pub heads: usize,
}

impl AttentionShape {
    /// The usual sizes, for which the passes are built with constants: that unrolls their inner loops and
    /// leaves no checks in them.
    pub(super) const WIDTH_32: Self = Self { width: 32, heads: 4 };
    pub(super) const WIDTH_64: Self = Self { width: 64, heads: 4 };
    pub(super) const WIDTH_128: Self = Self { width: 128, heads: 4 };

    #[inline(always)]
    pub(super) fn scale(self) -> f32 {
        1.0 / ((self.width / self.heads) as f32).sqrt()
    }
}

/// A pass whose sizes may be constants.
pub(super) trait AttentionWork {
    /// The sizes.
    fn shape(&self) -> AttentionShape;

    /// Runs the pass, summing `LANES` columns at a time; to be `#[inline(always)]`.
    fn pass<const LANES: usize>(self, shape: AttentionShape);
}

/// Runs a pass, built for its sizes if they are usual, with so many columns summed at a time for each width.
pub(super) fn run_sized<const NARROW: usize, const MEDIUM: usize, const BROAD: usize>(
    work: impl AttentionWork,
) {
    match work.shape() {
        AttentionShape::WIDTH_32 => run_widest(Sized::<_, 32, NARROW>(work)),
        AttentionShape::WIDTH_64 => run_widest(Sized::<_, 64, MEDIUM>(work)),
        AttentionShape::WIDTH_128 => run_widest(Sized::<_, 128, BROAD>(work)),
        _ => run_widest(Sized::<_, 0, MEDIUM>(work)),
    }
}

/// A pass of a usual width, or of any if `WIDTH` is 0.
struct Sized<W, const WIDTH: usize, const LANES: usize>(W);

impl<W: AttentionWork, const WIDTH: usize, const LANES: usize> Work for Sized<W, WIDTH, LANES> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let shape = match WIDTH {
            0 => self.0.shape(),
            width => AttentionShape { width, heads: 4 },
        };
        self.0.pass::<LANES>(shape);
    }
}

/// Writes the attention `weights [pairs, heads]` and the `output [queries, width]`.
///
/// `queries [queries, width]`; `keys_values [rows, 2 * width]` holds each row's key, then its value.
pub fn forward(
    shape: AttentionShape,
    visible: &VisibleLists,
    queries: &[f32],
    keys_values: &[f32],
    weights: &mut [f32],
    output: &mut [f32],
) {
    run_sized::<8, 16, 32>(Forward { shape, visible, queries, keys_values, weights, output });
}

struct Forward<'a> {
    shape: AttentionShape,
    visible: &'a VisibleLists,
    queries: &'a [f32],
    keys_values: &'a [f32],
    weights: &'a mut [f32],
    output: &'a mut [f32],
}

impl AttentionWork for Forward<'_> {
    fn shape(&self) -> AttentionShape {
        self.shape
    }

    #[inline(always)]
    fn pass<const LANES: usize>(self, shape: AttentionShape) {
        let AttentionShape { width, heads } = shape;
        let (head, scale) = (width / heads, shape.scale());
        for (index, output) in self.output.chunks_exact_mut(width).enumerate() {
            let query = &self.queries[index * width..][..width];
            let (start, list) = self.visible.span(index);
            let weights = &mut self.weights[start * heads..][..list.len() * heads];
            for (row, scores) in list.iter().zip(weights.chunks_exact_mut(heads)) {
                let key = &self.keys_values[*row as usize * 2 * width..][..width];
                dots(query, key, scores);
                scores.iter_mut().for_each(|score| *score *= scale);
            }
            softmax_columns(weights, heads);
            for (h, output) in output.chunks_exact_mut(head).enumerate() {
                let values = list.iter().zip(weights.chunks_exact(heads)).map(|(row, weights)| {
                    let value = (*row as usize * 2 + 1) * width + h * head;
                    (weights[h], &self.keys_values[value..][..head])
                });
                weighted_sum::<LANES>(None, values, output);
            }
        }
    }
}

/// The tensors of a backward pass through [`forward`].
#[derive(Debug)]
pub struct Backward<'a> {
    /// Queries `[queries, width]`, as in the forward pass.
    pub queries: &'a [f32],
    /// Keys and values `[rows, 2 * width]`, as in the forward pass.
    pub keys_values: &'a [f32],
    /// Attention weights `[pairs, heads]` that the forward pass wrote.
    pub weights: &'a [f32],
    /// Gradient of the output `[queries, width]`.
    pub d_output: &'a [f32],
    /// Space for `[longest list, heads]` numbers.
    pub d_scores: &'a mut [f32],
    /// Gradient of the queries `[queries, width]`, overwritten.
    pub d_queries: &'a mut [f32],
    /// Gradient of keys and values `[rows, 2 * width]`, overwritten.
    pub d_keys_values: &'a mut [f32],
}

/// Writes the gradients of queries, keys and values.
pub fn backward(shape: AttentionShape, visible: &VisibleLists, pass: Backward<'_>) {
    run_sized::<8, 16, 32>(BackwardWork { shape, visible, pass });
}

struct BackwardWork<'a> {
    shape: AttentionShape,
    visible: &'a VisibleLists,
    pass: Backward<'a>,
}

impl AttentionWork for BackwardWork<'_> {
    fn shape(&self) -> AttentionShape {
        self.shape
    }

    #[inline(always)]
    fn pass<const LANES: usize>(self, shape: AttentionShape) {
        let Self { visible, pass, .. } = self;
        let AttentionShape { width, heads } = shape;
        let (head, scale) = (width / heads, shape.scale());
        pass.d_keys_values.fill(0.0);
        for index in 0..visible.queries() {
            let (start, list) = visible.span(index);
            let query = &pass.queries[index * width..][..width];
            let d_output = &pass.d_output[index * width..][..width];
            let weights = &pass.weights[start * heads..][..list.len() * heads];
            let d_scores = &mut pass.d_scores[..list.len() * heads];

            for ((row, weights), d_weights) in
                list.iter().zip(weights.chunks_exact(heads)).zip(d_scores.chunks_exact_mut(heads))
            {
                let at = (*row as usize * 2 + 1) * width;
                let value = &pass.keys_values[at..][..width];
                let d_value = &mut pass.d_keys_values[at..][..width];
                dots(d_output, value, d_weights);
                for ((weight, d_out), d_v) in weights
                    .iter()
                    .zip(d_output.chunks_exact(head))
                    .zip(d_value.chunks_exact_mut(head))
                {
                    add_scaled(d_v, *weight, d_out);
                }
            }
            softmax_columns_backward(weights, d_scores, heads);

            d_scores.iter_mut().for_each(|d_score| *d_score *= scale);

            let d_query = &mut pass.d_queries[index * width..][..width];
            for (h, d_query) in d_query.chunks_exact_mut(head).enumerate() {
                let keys = list.iter().zip(d_scores.chunks_exact(heads)).map(|(row, d_scores)| {
                    (d_scores[h], &pass.keys_values[*row as usize * 2 * width + h * head..][..head])
                });
                weighted_sum::<LANES>(None, keys, d_query);
            }
            for (row, d_scores) in list.iter().zip(d_scores.chunks_exact(heads)) {
                let d_key = &mut pass.d_keys_values[*row as usize * 2 * width..][..width];
                for ((d_score, q), d_k) in
                    d_scores.iter().zip(query.chunks_exact(head)).zip(d_key.chunks_exact_mut(head))
                {
                    add_scaled(d_k, *d_score, q);
                }
            }
        }
    }
}

/// Heads whose softmax is computed at once.
const GROUP: usize = 4;

/// Softmax down each column of `scores [list, heads]`, in place. An empty list stays empty.
#[inline(always)]
pub(super) fn softmax_columns(scores: &mut [f32], heads: usize) {
    let whole = heads / GROUP * GROUP;
    for first in (0..whole).step_by(GROUP) {
        softmax_group::<GROUP>(scores, heads, first);
    }
    for head in whole..heads {
        softmax_group::<1>(scores, heads, head);
    }
}

#[inline(always)]
fn softmax_group<const HEADS: usize>(scores: &mut [f32], heads: usize, first: usize) {
    let mut largest = [f32::NEG_INFINITY; HEADS];
    for scores in scores.chunks_exact(heads) {
        for (largest, score) in largest.iter_mut().zip(&scores[first..][..HEADS]) {
            *largest = if *score > *largest { *score } else { *largest };
        }
    }
    let mut sums = [0.0; HEADS];
    for scores in scores.chunks_exact_mut(heads) {
        let scores = &mut scores[first..][..HEADS];
        for ((score, largest), sum) in scores.iter_mut().zip(largest).zip(&mut sums) {
            *score = exp(*score - largest);
            *sum += *score;
        }
    }
    let shares = sums.map(|sum| 1.0 / sum);
    for weights in scores.chunks_exact_mut(heads) {
        for (weight, share) in weights[first..][..HEADS].iter_mut().zip(shares) {
            *weight *= share;
        }
    }
}

/// Turns gradients of the weights into gradients of the scores: `p * (d - sum(p * d))`.
#[inline(always)]
pub(super) fn softmax_columns_backward(weights: &[f32], gradient: &mut [f32], heads: usize) {
    let whole = heads / GROUP * GROUP;
    for first in (0..whole).step_by(GROUP) {
        softmax_group_backward::<GROUP>(weights, gradient, heads, first);
    }
    for head in whole..heads {
        softmax_group_backward::<1>(weights, gradient, heads, head);
    }
}

#[inline(always)]
fn softmax_group_backward<const HEADS: usize>(
    weights: &[f32],
    gradient: &mut [f32],
    heads: usize,
    first: usize,
) {
    let mut sums = [0.0; HEADS];
    for (weights, slopes) in weights.chunks_exact(heads).zip(gradient.chunks_exact(heads)) {
        let (weights, slopes) = (&weights[first..][..HEADS], &slopes[first..][..HEADS]);
        for ((sum, p), d) in sums.iter_mut().zip(weights).zip(slopes) {
            *sum += p * d;
        }
    }
    for (weights, slopes) in weights.chunks_exact(heads).zip(gradient.chunks_exact_mut(heads)) {
        let (weights, slopes) = (&weights[first..][..HEADS], &mut slopes[first..][..HEADS]);
        for ((sum, p), d) in sums.iter().zip(weights).zip(slopes) {
            *d = p * (*d - sum);
        }
    }
}

#[cfg(test)]
mod tests;
