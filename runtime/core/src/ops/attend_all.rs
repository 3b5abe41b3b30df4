//! Multi-head attention of every entity's query.

use serde::{Deserialize, Serialize};

use super::{Linear, Place, Scratch, Sizes, places};
use crate::kernels::dot::dot;
use crate::kernels::nonzero::collect;
use crate::kernels::product::{padded, product, sparse_product};
use crate::kernels::softmax::softmax;
use crate::policy::DecideError;

/// Attention in which every embedded row asks and every one answers (dissertation section 2.3).
///
/// With as many queries as rows, keys and values are worth computing: s_ij = q_i · k_j, y_i = W_o Σ_j a_ij v_j.
/// Query, key and value layers have a padded head for every head among their outputs, so that heads start
/// at whole tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AttendAll {
    /// The rows, `[n_max, padded width]` or longer.
    pub rows: Place,
    /// Width E of a row.
    pub width: u16,
    /// Heads.
    pub heads: u16,
    /// W_q, divided by the root of the head width.
    pub query: Linear,
    /// W_k.
    pub key: Linear,
    /// W_v.
    pub value: Linear,
    /// W_o; its inputs are the heads' outputs, each padded.
    pub output: Linear,
    /// Whether a ReLU follows.
    pub relu: bool,
    /// q of every row, `[n_max, heads · padded head width]`.
    pub queries: Place,
    /// k of every row, alike.
    pub keys: Place,
    /// v of every row, alike.
    pub values: Place,
    /// Weights of one query and head, `[n_max]`.
    pub scores: Place,
    /// The heads' outputs of one query.
    pub attended: Place,
    /// The result, `[n_max, padded outputs]`.
    pub to: Place,
}

impl AttendAll {
    /// Floats of all heads' queries, keys or values of one row.
    fn inner(&self) -> usize {
        usize::from(self.output.inputs)
    }

    fn head_width(&self) -> usize {
        self.inner().checked_div(usize::from(self.heads)).unwrap_or(0)
    }

    fn padded_width(&self) -> usize {
        padded(usize::from(self.width))
    }

    pub(super) fn check(&self, sizes: &Sizes) -> bool {
        let inner = self.inner();
        let projections = [&self.query, &self.key, &self.value];
        let fits = |layer: &&Linear| {
            layer.check(sizes)
                && layer.inputs == self.width
                && usize::from(layer.outputs) == inner
                && layer.padded_outputs() == inner
        };
        let heads = self.head_width();
        let layers = projections.iter().all(fits)
            && self.output.check(sizes)
            && heads > 0
            && heads.is_multiple_of(8)
            && heads * usize::from(self.heads) == inner
            && sizes.lists(u64::from(self.width));
        let lengths = sizes.holds_rows(&self.rows, self.padded_width())
            && [&self.queries, &self.keys, &self.values]
                .iter()
                .all(|place| sizes.holds_rows(place, inner))
            && self.scores.len == sizes.n_max
            && self.attended.len as usize == inner
            && sizes.holds_rows(&self.to, self.output.padded_outputs());
        layers && lengths && sizes.hold_apart(&self.places())
    }

    fn places(&self) -> [&Place; 7] {
        let own = [&self.queries, &self.keys, &self.values];
        let [queries, keys, values] = own;
        [&self.rows, queries, keys, values, &self.scores, &self.attended, &self.to]
    }

    pub(super) fn multiply_adds(&self, visible: usize) -> usize {
        let layers = [&self.query, &self.key, &self.value, &self.output];
        let per_row: usize = layers.iter().map(|layer| layer.weights_len()).sum();
        visible * per_row + 2 * visible * visible * self.inner()
    }

    #[inline(always)]
    pub(super) fn run(
        &self,
        weights: &[f32],
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let visible = scratch.visible;
        let [rows, queries, keys, values, scores, attended, to] =
            places(scratch.floats, self.places())?;
        for (layer, to) in
            [(&self.query, &mut *queries), (&self.key, &mut *keys), (&self.value, &mut *values)]
        {
            let (matrix, around) = (layer.matrix(weights)?, layer.around(weights, false)?);
            let rows = rows.chunks_exact(self.padded_width()).take(visible);
            for (row, to) in rows.zip(to.chunks_exact_mut(self.inner().max(1))) {
                let row = row.get(..usize::from(self.width)).ok_or(DecideError::BadLength)?;
                let count = collect(row, scratch.nonzeros);
                let inputs = scratch.nonzeros.get(..count).ok_or(DecideError::BadLength)?;
                sparse_product(matrix, usize::from(self.width), inputs, around, to);
            }
        }
        let scores = scores.get_mut(..visible).ok_or(DecideError::BadLength)?;
        let (matrix, around) =
            (self.output.matrix(weights)?, self.output.around(weights, self.relu)?);
        let queries = queries.chunks_exact(self.inner().max(1)).take(visible);
        for (query, to) in queries.zip(to.chunks_exact_mut(self.output.padded_outputs())) {
            self.attend(query, keys, values, scores, attended)?;
            product(matrix, attended, around, to);
        }
        Ok(())
    }

    /// The heads' outputs of one query.
    #[inline(always)]
    fn attend(
        &self,
        query: &[f32],
        keys: &[f32],
        values: &[f32],
        scores: &mut [f32],
        attended: &mut [f32],
    ) -> Result<(), DecideError> {
        let (inner, head) = (self.inner().max(1), self.head_width().max(1));
        attended.fill(0.0);
        let heads = query.chunks_exact(head).zip(attended.chunks_exact_mut(head));
        for (index, (query, output)) in heads.enumerate() {
            let part = |row| part(row, index * head, head);
            for (score, key) in scores.iter_mut().zip(keys.chunks_exact(inner)) {
                *score = dot(query, part(key)?);
            }
            if !softmax(scores) {
                return Err(DecideError::NonFinite);
            }
            for (weight, value) in scores.iter().zip(values.chunks_exact(inner)) {
                for (sum, value) in output.iter_mut().zip(part(value)?) {
                    *sum += weight * value;
                }
            }
        }
        Ok(())
    }
}

#[inline(always)]
fn part(row: &[f32], start: usize, len: usize) -> Result<&[f32], DecideError> {
    row.get(start..start.saturating_add(len)).ok_or(DecideError::BadLength)
}
