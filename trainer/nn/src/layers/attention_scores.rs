//! How large the scores of an attention layer are, before they are scaled: what a penalty keeps small.
//!
//! Dissertation chapter 3, public code: the mean squared score of queries and keys joins the critic's loss.

use super::attention::{AttentionShape, VisibleLists};
use super::vectors::{add_scaled, dots};
use super::wide::{Work, run_widest};

/// Most heads.
const HEADS: usize = 64;

/// Writes `[queries]` the sum over all heads of the squared scores `q . k` of what each query sees.
///
/// `queries [queries, width]`; `keys_values [rows, 2 * width]` holds each row's key, then its value.
pub fn forward(
    shape: AttentionShape,
    visible: &VisibleLists,
    queries: &[f32],
    keys_values: &[f32],
    sums: &mut [f32],
) {
    run_widest(Forward { shape, visible, queries, keys_values, sums });
}

struct Forward<'a> {
    shape: AttentionShape,
    visible: &'a VisibleLists,
    queries: &'a [f32],
    keys_values: &'a [f32],
    sums: &'a mut [f32],
}

impl Work for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let AttentionShape { width, heads } = self.shape;
        let mut scores = [0.0; HEADS];
        let scores = &mut scores[..heads];
        for (index, sum) in self.sums.iter_mut().enumerate() {
            let query = &self.queries[index * width..][..width];
            *sum = 0.0;
            for row in self.visible.list(index) {
                dots(query, &self.keys_values[row * 2 * width..][..width], scores);
                *sum += scores.iter().map(|score| score * score).sum::<f32>();
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
    /// Gradient of the sums `[queries]`.
    pub d_sums: &'a [f32],
    /// Gradient of the queries `[queries, width]`, added to.
    pub d_queries: &'a mut [f32],
    /// Gradient of keys and values `[rows, 2 * width]`, that of keys added to.
    pub d_keys_values: &'a mut [f32],
}

/// Adds the gradients of queries and keys.
pub fn backward(shape: AttentionShape, visible: &VisibleLists, pass: Backward<'_>) {
    run_widest(BackwardWork { shape, visible, pass });
}

struct BackwardWork<'a> {
    shape: AttentionShape,
    visible: &'a VisibleLists,
    pass: Backward<'a>,
}

impl Work for BackwardWork<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { visible, pass, shape: AttentionShape { width, heads } } = self;
        let head = width / heads;
        let mut scores = [0.0; HEADS];
        let scores = &mut scores[..heads];
        for (index, d_sum) in pass.d_sums.iter().enumerate() {
            let query = &pass.queries[index * width..][..width];
            let d_query = &mut pass.d_queries[index * width..][..width];
            for row in visible.list(index) {
                let at = row * 2 * width;
                let key = &pass.keys_values[at..][..width];
                let d_key = &mut pass.d_keys_values[at..][..width];
                dots(query, key, scores);
                for (h, score) in scores.iter().enumerate() {
                    let (columns, factor) = (h * head..(h + 1) * head, 2.0 * d_sum * score);
                    add_scaled(&mut d_query[columns.clone()], factor, &key[columns.clone()]);
                    add_scaled(&mut d_key[columns.clone()], factor, &query[columns]);
                }
            }
        }
    }
}
