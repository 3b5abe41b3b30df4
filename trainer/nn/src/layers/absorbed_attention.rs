//! Attention without keys and values: the same result as [`super::attention`] by fewer products.
//!
//! A head's score `q . K x` is `(K' q) . x`, and its output `sum w V x` is `V (sum w x)`. So the query
//! absorbs the key matrix once, and the value matrix is applied once to the weighted sum of entities.
//! Per query that takes `2 E^2` multiplications, and `2 H E` per visible entity, where keys and values
//! take `2 E^2` per entity: a gain where entities are seen by few queries each.

use super::attention::{AttentionShape, Columns, List, run_with_shape, softmax_columns_backward};
use super::lists::VisibleLists;
use super::matrix::{Matrix, MatrixMut, Store, multiply};
use super::vectors::add_scaled;

/// The key and value matrices `[2 E, E]`, keys first.
#[derive(Clone, Copy, Debug)]
struct Heads<'a> {
    shape: AttentionShape,
    keys_values: &'a [f32],
}

impl<'a> Heads<'a> {
    fn width(self) -> usize {
        self.shape.width / self.shape.heads
    }

    /// The key matrix `[head width, E]` of a head, or its value matrix if `values`.
    fn matrix(self, head: usize, values: bool) -> Matrix<'a> {
        let (width, rows) = (self.shape.width, self.width());
        let first = head + if values { self.shape.heads } else { 0 };
        Matrix::new(&self.keys_values[first * rows * width..][..rows * width], rows, width)
    }
}

/// Buffers of one worker: what the last forward pass needs to be gone through backward.
#[derive(Clone, Debug, Default)]
pub struct AbsorbedAttention {
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

/// The tensors of a backward pass.
#[derive(Debug)]
pub struct AbsorbedBackward<'a> {
    /// Queries `[queries, E]`, as in the forward pass.
    pub queries: &'a [f32],
    /// Entities `[rows, E]`, as in the forward pass.
    pub entities: &'a [f32],
    /// Gradient of the output `[queries, E]`.
    pub d_output: &'a [f32],
    /// Gradient of the queries `[queries, E]`, overwritten.
    pub d_queries: &'a mut [f32],
    /// Gradient of the entities `[rows, E]`, overwritten.
    pub d_entities: &'a mut [f32],
    /// Gradient of the key and value matrices `[2 E, E]`, added to.
    pub d_keys_values: &'a mut [f32],
}

impl AbsorbedAttention {
    /// Writes the `output [queries, E]` from `queries [queries, E]` and `entities [rows, E]`.
    ///
    /// `keys_values [2 E, E]` are the key and value matrices.
    pub fn forward(
        &mut self,
        shape: AttentionShape,
        visible: &VisibleLists,
        keys_values: &[f32],
        (queries, entities): (&[f32], &[f32]),
        output: &mut [f32],
    ) {
        let AttentionShape { width, heads } = shape;
        let matrices = Heads { shape, keys_values };
        let (count, head) = (visible.queries(), matrices.width());
        let wide = heads * width;
        self.absorbed.resize(count * wide, 0.0);
        self.sums.resize(count * wide, 0.0);
        self.weights.resize(visible.pairs() * heads, 0.0);
        for h in 0..heads {
            multiply(
                MatrixMut::new(&mut self.absorbed, count, wide).columns(h * width..(h + 1) * width),
                Store::Replace,
                Matrix::new(queries, count, width).columns(h * head..(h + 1) * head),
                matrices.matrix(h, false),
            );
        }
        self.attend(shape, visible, entities);
        for h in 0..heads {
            multiply(
                MatrixMut::new(output, count, width).columns(h * head..(h + 1) * head),
                Store::Replace,
                Matrix::new(&self.sums, count, wide).columns(h * width..(h + 1) * width),
                matrices.matrix(h, true).transposed(),
            );
        }
    }

    /// The attention weights `[pairs, heads]` of the last forward pass.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Writes the gradients of queries and entities, and adds that of the matrices.
    pub fn backward(
        &mut self,
        shape: AttentionShape,
        visible: &VisibleLists,
        keys_values: &[f32],
        pass: AbsorbedBackward<'_>,
    ) {
        let AttentionShape { width, heads } = shape;
        let matrices = Heads { shape, keys_values };
        let (count, head) = (visible.queries(), matrices.width());
        let wide = heads * width;
        self.d_sums.resize(count * wide, 0.0);
        let (d_keys, d_values) = pass.d_keys_values.split_at_mut(width * width);
        let d_output = Matrix::new(pass.d_output, count, width);
        for h in 0..heads {
            let (narrow, broad) = (h * head..(h + 1) * head, h * width..(h + 1) * width);
            let d_output = d_output.columns(narrow);
            multiply(
                MatrixMut::new(&mut self.d_sums, count, wide).columns(broad.clone()),
                Store::Replace,
                d_output,
                matrices.matrix(h, true),
            );
            multiply(
                MatrixMut::new(&mut d_values[h * head * width..], head, width),
                Store::Add,
                d_output.transposed(),
                Matrix::new(&self.sums, count, wide).columns(broad),
            );
        }
        self.d_absorbed.resize(self.d_sums.len(), 0.0);
        self.descend(shape, visible, pass.entities, pass.d_entities);
        let queries = Matrix::new(pass.queries, count, width);
        for h in 0..heads {
            let (narrow, broad) = (h * head..(h + 1) * head, h * width..(h + 1) * width);
            let d_absorbed = Matrix::new(&self.d_absorbed, count, wide).columns(broad);
            multiply(
                MatrixMut::new(pass.d_queries, count, width).columns(narrow.clone()),
                Store::Replace,
                d_absorbed,
                matrices.matrix(h, false).transposed(),
            );
            multiply(
                MatrixMut::new(&mut d_keys[h * head * width..], head, width),
                Store::Add,
                queries.columns(narrow).transposed(),
                d_absorbed,
            );
        }
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
                    let list = List { rows, columns: Columns::all(width), heads };
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
                    let list = List { rows, columns: Columns::all(width), heads };
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
            let mut weights = vec![0.0; lists().pairs() * shape.heads];
            attention::forward(shape, &lists(), &queries, &keys_values, &mut weights, &mut want);
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
