//! Attention without keys and values: the same result as [`super::attention`] by fewer products.
//!
//! A head's score `q . K x` is `(K' q) . x`, and its output `sum w V x` is `V (sum w x)`. So the query
//! absorbs the key matrix once, and the value matrix is applied once to the weighted sum of entities.
//! Per query that takes `2 E^2` multiplications, and `2 H E` per visible entity, where keys and values
//! take `2 E^2` per entity: a gain where entities are seen by few queries each.

use super::attention::{AttentionShape, List, run_with_shape, softmax_columns_backward};
use super::lists::VisibleLists;
use super::matrix::{Matrix, MatrixMut, Store, multiply};
use super::vectors::add_scaled;

/// The key or the value matrices `[head width, E]` of all heads, and products with them: of *narrow* rows, which have their
/// E numbers in a part for each head, and *broad* ones, which have E for each.
#[derive(Clone, Copy, Debug)]
struct Heads<'a> {
    shape: AttentionShape,
    matrices: &'a [f32],
}

impl<'a> Heads<'a> {
    /// Key matrices, and value matrices.
    fn of(shape: AttentionShape, keys_values: &'a [f32]) -> [Self; 2] {
        let (keys, values) = keys_values.split_at(shape.width * shape.width);
        [keys, values].map(|matrices| Self { shape, matrices })
    }

    fn matrix(self, head: usize) -> Matrix<'a> {
        let (width, rows) = (self.shape.width, self.shape.head_width());
        Matrix::new(&self.matrices[head * rows * width..], rows, width)
    }

    /// Writes broad rows, each part a narrow row's times the matrix.
    fn widen(self, narrow: &[f32], broad: &mut [f32]) {
        let AttentionShape { width, heads } = self.shape;
        let parts = [heads, self.shape.head_width()];
        for head in 0..heads {
            let out = part_mut(broad, [heads, width], head);
            multiply(out, Store::Replace, part(narrow, parts, head), self.matrix(head));
        }
    }

    /// Writes narrow rows, each part a broad row's times the matrix turned.
    fn narrow(self, broad: &[f32], narrow: &mut [f32]) {
        let AttentionShape { width, heads } = self.shape;
        let parts = [heads, self.shape.head_width()];
        for head in 0..heads {
            let out = part_mut(narrow, parts, head);
            let matrix = self.matrix(head).transposed();
            multiply(out, Store::Replace, part(broad, [heads, width], head), matrix);
        }
    }
}

/// Adds the gradient of the matrices that take narrow rows and broad ones to each other, one of which is a gradient.
fn add_gradient(shape: AttentionShape, narrow: &[f32], broad: &[f32], d_matrices: &mut [f32]) {
    let (AttentionShape { width, heads }, rows) = (shape, shape.head_width());
    for head in 0..heads {
        let out = MatrixMut::new(&mut d_matrices[head * rows * width..], rows, width);
        let narrow = part(narrow, [heads, rows], head).transposed();
        multiply(out, Store::Add, narrow, part(broad, [heads, width], head));
    }
}

/// The columns of a head in rows of so many parts of a width.
fn part(rows: &[f32], [heads, width]: [usize; 2], head: usize) -> Matrix<'_> {
    let all = heads * width;
    Matrix::new(rows, rows.len() / all, all).columns(head * width..(head + 1) * width)
}

/// The same, to be written.
fn part_mut(rows: &mut [f32], [heads, width]: [usize; 2], head: usize) -> MatrixMut<'_> {
    let (all, count) = (heads * width, rows.len() / (heads * width));
    MatrixMut::new(rows, count, all).columns(head * width..(head + 1) * width)
}

/// Buffers of one worker: what the last forward pass needs to be gone through backward.
#[derive(Clone, Debug, Default)]
pub(crate) struct AbsorbedAttention {
    /// Queries that absorbed their keys `[queries, H, E]`.
    absorbed: Vec<f32>,
    /// `[pairs, H]`
    weights: Vec<f32>,
    /// Weighted sums of entities `[queries, H, E]`.
    sums: Vec<f32>,
    d_absorbed: Vec<f32>,
    d_sums: Vec<f32>,
    d_scores: Vec<f32>,
}

/// The tensors of a backward pass: those of the forward pass, and their gradients, of which that of the matrices is added to
/// and the others are overwritten.
#[derive(Debug)]
pub(crate) struct AbsorbedBackward<'a> {
    pub(crate) queries: &'a [f32],
    pub(crate) entities: &'a [f32],
    pub(crate) d_output: &'a [f32],
    pub(crate) d_queries: &'a mut [f32],
    pub(crate) d_entities: &'a mut [f32],
    pub(crate) d_keys_values: &'a mut [f32],
}

impl AbsorbedAttention {
    /// Writes the `output [queries, E]` from `queries [queries, E]` and `entities [rows, E]`.
    ///
    /// `keys_values [2 E, E]` are the key and value matrices.
    pub(crate) fn forward(
        &mut self,
        shape: AttentionShape,
        visible: &VisibleLists,
        keys_values: &[f32],
        (queries, entities): (&[f32], &[f32]),
        output: &mut [f32],
    ) {
        let [keys, values] = Heads::of(shape, keys_values);
        self.absorbed.resize(queries.len() * shape.heads, 0.0);
        self.sums.resize(queries.len() * shape.heads, 0.0);
        self.weights.resize(visible.pairs() * shape.heads, 0.0);
        keys.widen(queries, &mut self.absorbed);
        self.attend(shape, visible, entities);
        values.narrow(&self.sums, output);
    }

    /// The attention weights `[pairs, heads]` of the last forward pass.
    pub(crate) fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Writes the gradients of queries and entities, and adds that of the matrices.
    pub(crate) fn backward(
        &mut self,
        shape: AttentionShape,
        visible: &VisibleLists,
        keys_values: &[f32],
        pass: AbsorbedBackward<'_>,
    ) {
        let [keys, values] = Heads::of(shape, keys_values);
        let (d_keys, d_values) = pass.d_keys_values.split_at_mut(shape.width * shape.width);
        self.d_sums.resize(self.sums.len(), 0.0);
        self.d_absorbed.resize(self.sums.len(), 0.0);
        values.widen(pass.d_output, &mut self.d_sums);
        add_gradient(shape, pass.d_output, &self.sums, d_values);
        self.descend(shape, visible, pass.entities, pass.d_entities);
        keys.narrow(&self.d_absorbed, pass.d_queries);
        add_gradient(shape, pass.queries, &self.d_absorbed, d_keys);
    }

    /// Writes weights and weighted sums.
    fn attend(&mut self, shape: AttentionShape, visible: &VisibleLists, entities: &[f32]) {
        let Self { absorbed, weights, sums, .. } = self;
        run_with_shape(
            shape,
            #[inline(always)]
            |shape| {
                let AttentionShape { width, heads } = shape;
                let queries = absorbed.chunks_exact(heads * width);
                for (index, (query, sums)) in
                    queries.zip(sums.chunks_exact_mut(heads * width)).enumerate()
                {
                    let (start, rows) = visible.span(index);
                    let weights = &mut weights[start * heads..][..rows.len() * heads];
                    let list = List::whole(rows, shape);
                    list.weigh(entities, query, shape.scale(), weights);
                    list.sum(entities, weights, sums);
                }
            },
        );
    }

    /// Writes the gradients of the absorbed queries and of the entities.
    fn descend(
        &mut self,
        shape: AttentionShape,
        visible: &VisibleLists,
        entities: &[f32],
        d_entities: &mut [f32],
    ) {
        let Self { absorbed, weights, d_sums, d_scores, d_absorbed, .. } = self;
        d_entities.fill(0.0);
        run_with_shape(
            shape,
            #[inline(always)]
            |shape| {
                let AttentionShape { width, heads } = shape;
                for index in 0..visible.queries() {
                    let (start, rows) = visible.span(index);
                    let own = index * heads * width..(index + 1) * heads * width;
                    let weights = &weights[start * heads..][..rows.len() * heads];
                    let (d_sums, absorbed) = (&d_sums[own.clone()], &absorbed[own.clone()]);
                    let list = List::whole(rows, shape);
                    d_scores.resize(rows.len() * heads, 0.0);
                    list.products(entities, d_sums, d_scores);
                    softmax_columns_backward(weights, d_scores, heads);
                    d_scores.iter_mut().for_each(|d_score| *d_score *= shape.scale());
                    list.sum(entities, d_scores, &mut d_absorbed[own]);
                    let factors = weights.chunks_exact(heads).zip(d_scores.chunks_exact(heads));
                    for (row, (weights, d_scores)) in rows.iter().zip(factors) {
                        let d_entity = &mut d_entities[*row as usize * width..][..width];
                        for head in 0..heads {
                            let part = head * width..(head + 1) * width;
                            add_scaled(d_entity, weights[head], &d_sums[part.clone()]);
                            add_scaled(d_entity, d_scores[head], &absorbed[part]);
                        }
                    }
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::{assert_gradient, random};
    use crate::layers::attention;

    /// The usual sizes, and fewer heads than are computed at once.
    const SHAPES: [AttentionShape; 4] = [
        AttentionShape { width: 32, heads: 4 },
        AttentionShape { width: 64, heads: 4 },
        AttentionShape { width: 128, heads: 4 },
        AttentionShape { width: 8, heads: 2 },
    ];
    const QUERIES: usize = 3;
    const ROWS: usize = 5;

    /// The first query sees two rows, the second nothing, the third most.
    fn lists() -> VisibleLists {
        let mut lists = VisibleLists::default();
        for list in [&[0, 2][..], &[], &[0, 1, 2, 4]] {
            list.iter().for_each(|row| lists.push(*row));
            lists.end_list();
        }
        lists
    }

    fn forward(
        shape: AttentionShape,
        queries: &[f32],
        entities: &[f32],
        matrices: &[f32],
    ) -> Vec<f32> {
        let mut output = vec![f32::NAN; QUERIES * shape.width];
        let mut attention = AbsorbedAttention::default();
        attention.forward(shape, &lists(), matrices, (queries, entities), &mut output);
        output
    }

    /// Queries, entities and matrices; the wider, the smaller the matrices, so that scores stay moderate.
    fn inputs(AttentionShape { width, .. }: AttentionShape) -> [Vec<f32>; 3] {
        let mut matrices = random(3, 2 * width * width);
        matrices.iter_mut().for_each(|weight| *weight *= 8.0 / width as f32);
        [random(1, QUERIES * width), random(2, ROWS * width), matrices]
    }

    #[test]
    fn the_result_is_that_of_keys_and_values() {
        for shape in SHAPES {
            let width = shape.width;
            let [queries, entities, matrices] = inputs(shape);
            let mut keys_values = vec![0.0; ROWS * 2 * width];
            multiply(
                MatrixMut::new(&mut keys_values, ROWS, 2 * width),
                Store::Replace,
                Matrix::new(&entities, ROWS, width),
                Matrix::new(&matrices, 2 * width, width).transposed(),
            );
            let mut want = vec![f32::NAN; QUERIES * width];
            let pass = attention::Forward {
                queries: &queries,
                keys_values: &keys_values,
                of_pairs: &mut vec![0.0; lists().pairs() * shape.heads],
                shares: &mut [],
                output: &mut want,
            };
            attention::forward(shape, &lists(), pass);
            for (got, want) in forward(shape, &queries, &entities, &matrices).iter().zip(&want) {
                assert!((got - want).abs() < 1e-5, "{got} against {want}");
            }
        }
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        for shape in SHAPES {
            let width = shape.width;
            let [queries, entities, matrices] = inputs(shape);
            let d_output = random(4, QUERIES * width);
            let loss = |output: Vec<f32>| -> f64 {
                output.iter().zip(&d_output).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
            };
            let mut attention = AbsorbedAttention::default();
            let mut output = vec![0.0; QUERIES * width];
            attention.forward(shape, &lists(), &matrices, (&queries, &entities), &mut output);
            let mut d_queries = vec![f32::NAN; queries.len()];
            let mut d_entities = vec![f32::NAN; entities.len()];
            let mut d_matrices = vec![0.0; matrices.len()];
            let pass = AbsorbedBackward {
                queries: &queries,
                entities: &entities,
                d_output: &d_output,
                d_queries: &mut d_queries,
                d_entities: &mut d_entities,
                d_keys_values: &mut d_matrices,
            };
            attention.backward(shape, &lists(), &matrices, pass);
            let run = |queries: &[f32], entities: &[f32], matrices: &[f32]| {
                loss(forward(shape, queries, entities, matrices))
            };
            assert_gradient("queries", &queries, &d_queries, |q| run(q, &entities, &matrices));
            assert_gradient("entities", &entities, &d_entities, |x| run(&queries, x, &matrices));
            assert_gradient("matrices", &matrices, &d_matrices, |m| run(&queries, &entities, m));
            let unseen = &d_entities[3 * width..4 * width];
            assert!(unseen.iter().all(|slope| *slope == 0.0), "nobody sees entity 3");
        }
    }
}
