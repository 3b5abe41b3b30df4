//! Multi-head attention of every entity's query.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::{Flag, LAYOUT_TILES, Linear, Place, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::product::{Sparse, padded};
use crate::kernels::rows::Rows;
use crate::kernels::softmax::slots;
use crate::policy::{DecideError, Observation};

/// Attention in which every embedded row asks and every one answers (dissertation section 2.3).
///
/// With as many queries as rows, keys and values are worth computing: s_ij = q_i · k_j, y_i = W_o Σ_j a_ij v_j.
/// Query, key and value layers have a padded head for every head among their outputs, so that heads start
/// at whole tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
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
    pub relu: Flag,
    /// q of every head and row, `[heads, visible, padded head width]`, with room for `n_max` rows.
    pub queries: Place,
    /// k, alike.
    pub keys: Place,
    /// v, alike.
    pub values: Place,
    /// Weights of one query and head, `[n_max]`.
    pub scores: Place,
    /// The heads' outputs of one query; before, q, k or v of one row.
    pub attended: Place,
    /// The result, `[n_max, padded outputs]`.
    pub to: Place,
}

impl Operator for AttendAll {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
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
        layers && lengths && sizes.hold_apart(&self.places().each_ref())
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        let layers = [&self.query, &self.key, &self.value, &self.output];
        let per_row: u64 = layers.iter().map(|layer| layer.multiply_adds()).sum();
        visible * per_row + 2 * visible * visible * self.inner() as u64
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let visible = scratch.visible;
        self.project(kernels, weights, scratch)?;
        let [_, queries, keys, values, scores, attended, to] =
            places(scratch.floats, self.places().each_ref())?;
        let scores = scores.get_mut(..slots(visible)).ok_or(DecideError::BadLength)?;
        let (matrix, around) =
            (self.output.matrix(weights)?, self.output.around(weights, self.relu.is_set())?);
        let (head, of_head) = self.head_floats(visible);
        let to = to.chunks_exact_mut(self.output.padded_outputs()).take(visible);
        for (row, to) in to.enumerate() {
            let keys_and_values = keys.chunks_exact(of_head).zip(values.chunks_exact(of_head));
            let heads = queries.chunks_exact(of_head).zip(keys_and_values);
            for ((queries, (keys, values)), output) in heads.zip(attended.chunks_exact_mut(head)) {
                let query = queries.chunks_exact(head).nth(row).ok_or(DecideError::BadLength)?;
                kernels.dots(query, Rows::first(keys, head, visible), scores);
                if !kernels.softmax(scores, visible) {
                    return Err(DecideError::NonFinite);
                }
                kernels.mix(scores, Rows::first(values, head, visible), output);
            }
            kernels.product(matrix, attended, around, to);
        }
        Ok(())
    }
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

    fn places(&self) -> [Place; 7] {
        // Scores are worked on in whole vectors, for which a plan leaves room behind the last one.
        let scores = Place { len: slots(self.scores.len as usize) as u32, ..self.scores };
        let Self { rows, queries, keys, values, attended, to, .. } = *self;
        [rows, queries, keys, values, scores, attended, to]
    }

    /// Computes q, k and v of every row.
    #[inline(always)]
    fn project(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let [rows, queries, keys, values, _, attended, _] =
            places(scratch.floats, self.places().each_ref())?;
        let (head, of_head) = self.head_floats(scratch.visible);
        for (layer, to) in [(&self.query, queries), (&self.key, keys), (&self.value, values)] {
            let (matrix, around) = (layer.matrix(weights)?, layer.around(weights, false)?);
            let rows = rows.chunks_exact(self.padded_width()).take(scratch.visible);
            for (row, values) in rows.enumerate() {
                let values = values.get(..usize::from(self.width));
                let values = values.ok_or(DecideError::BadLength)?;
                kernels.mark(values, scratch.nonzeros);
                let marks = &*scratch.nonzeros;
                let inputs = Sparse { values, marks, one: None, count: values.len() };
                kernels.sparse_product(matrix, inputs, around, attended);
                let heads = to.chunks_exact_mut(of_head).zip(attended.chunks_exact(head.max(1)));
                for (to, values) in heads {
                    let to = to.chunks_exact_mut(head.max(1)).nth(row);
                    let to = to.ok_or(DecideError::BadLength)?;
                    for (to, value) in to.iter_mut().zip(values) {
                        *to = *value;
                    }
                }
            }
        }
        Ok(())
    }

    /// Floats of one head in a row, and in all visible rows; neither is zero, which the optimiser forgets in loops.
    fn head_floats(&self, visible: usize) -> (usize, usize) {
        let head = self.head_width().max(1);
        (head, head.saturating_mul(visible).max(1))
    }
}
