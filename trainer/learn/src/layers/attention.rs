//! Masked multi-head attention over ragged lists: each query attends to the entities that it sees.
//!
//! Dissertation section 2.3 and the public code's entity attention layer, between its two projections:
//! scores `q . k / sqrt(head width)`, softmax over the visible entities only, weighted sum of values.
//! A query that sees nothing gets a zero vector. Invisible entities are never touched, which is exact
//! because their weight is zero.

/// For each query the rows that it sees.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleLists {
    /// Query i sees `rows[ends[i] .. ends[i + 1]]`; the first end is 0.
    ends: Vec<u32>,
    rows: Vec<u32>,
}

impl Default for VisibleLists {
    fn default() -> Self {
        Self { ends: vec![0], rows: Vec::new() }
    }
}

impl VisibleLists {
    /// Forgets all lists, keeps the memory.
    pub fn clear(&mut self) {
        self.ends.truncate(1);
        self.rows.clear();
    }

    /// Adds a row to the list that the next [`end_list`](Self::end_list) closes.
    pub fn push(&mut self, row: usize) {
        self.rows.push(row as u32);
    }

    /// Closes the list of one query.
    pub fn end_list(&mut self) {
        self.ends.push(self.rows.len() as u32);
    }

    /// Number of queries.
    pub fn queries(&self) -> usize {
        self.ends.len() - 1
    }

    /// Total length of all lists.
    pub fn pairs(&self) -> usize {
        self.rows.len()
    }

    /// The rows that a query sees.
    pub fn list(&self, query: usize) -> impl Iterator<Item = usize> + '_ {
        self.span(query).1.iter().map(|row| *row as usize)
    }

    /// Where a query's pairs begin, and its rows.
    pub(super) fn span(&self, query: usize) -> (usize, &[u32]) {
        let (start, end) = (self.ends[query] as usize, self.ends[query + 1] as usize);
        (start, &self.rows[start..end])
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
    pub(super) fn scale(self) -> f32 {
        1.0 / ((self.width / self.heads) as f32).sqrt()
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
    let AttentionShape { width, heads } = shape;
    let (head, scale) = (width / heads, shape.scale());
    for (index, output) in output.chunks_exact_mut(width).enumerate() {
        let query = &queries[index * width..][..width];
        let (start, list) = visible.span(index);
        let weights = &mut weights[start * heads..][..list.len() * heads];
        for (row, weights) in list.iter().zip(weights.chunks_exact_mut(heads)) {
            let key = &keys_values[*row as usize * 2 * width..][..width];
            for ((weight, q), k) in
                weights.iter_mut().zip(query.chunks_exact(head)).zip(key.chunks_exact(head))
            {
                *weight = dot(q, k) * scale;
            }
        }
        softmax_columns(weights, heads);
        output.fill(0.0);
        for (row, weights) in list.iter().zip(weights.chunks_exact(heads)) {
            let value = &keys_values[(*row as usize * 2 + 1) * width..][..width];
            for ((weight, out), v) in
                weights.iter().zip(output.chunks_exact_mut(head)).zip(value.chunks_exact(head))
            {
                for (out, v) in out.iter_mut().zip(v) {
                    *out += weight * v;
                }
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
            for ((((weight, d_weight), d_out), v), d_v) in weights
                .iter()
                .zip(d_weights)
                .zip(d_output.chunks_exact(head))
                .zip(value.chunks_exact(head))
                .zip(d_value.chunks_exact_mut(head))
            {
                *d_weight = dot(d_out, v);
                add_scaled(d_v, *weight, d_out);
            }
        }
        softmax_columns_backward(weights, d_scores, heads);

        let d_query = &mut pass.d_queries[index * width..][..width];
        d_query.fill(0.0);
        for (row, d_scores) in list.iter().zip(d_scores.chunks_exact(heads)) {
            let at = *row as usize * 2 * width;
            let key = &pass.keys_values[at..][..width];
            let d_key = &mut pass.d_keys_values[at..][..width];
            for ((((d_score, q), k), d_q), d_k) in d_scores
                .iter()
                .zip(query.chunks_exact(head))
                .zip(key.chunks_exact(head))
                .zip(d_query.chunks_exact_mut(head))
                .zip(d_key.chunks_exact_mut(head))
            {
                add_scaled(d_q, d_score * scale, k);
                add_scaled(d_k, d_score * scale, q);
            }
        }
    }
}

/// Softmax down each column of `scores [list, heads]`, in place. An empty list stays empty.
pub(super) fn softmax_columns(scores: &mut [f32], heads: usize) {
    for j in 0..heads.min(scores.len()) {
        let column = scores[j..].iter().step_by(heads);
        let max = column.fold(f32::NEG_INFINITY, |max, score| max.max(*score));
        let mut sum = 0.0;
        for score in scores[j..].iter_mut().step_by(heads) {
            *score = (*score - max).exp();
            sum += *score;
        }
        for score in scores[j..].iter_mut().step_by(heads) {
            *score /= sum;
        }
    }
}

/// Turns gradients of the weights into gradients of the scores: `p * (d - sum(p * d))`.
pub(super) fn softmax_columns_backward(weights: &[f32], gradient: &mut [f32], heads: usize) {
    for j in 0..heads {
        let mut sum = 0.0;
        for (p, d) in weights.iter().zip(gradient.iter()).skip(j).step_by(heads) {
            sum += p * d;
        }
        for (p, d) in weights.iter().zip(gradient.iter_mut()).skip(j).step_by(heads) {
            *d = p * (*d - sum);
        }
    }
}

/// Dot product in eight lanes, summed in a fixed order.
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; 8];
    let (a_whole, a_rest) = a.as_chunks::<8>();
    let (b_whole, b_rest) = b.as_chunks::<8>();
    for (a, b) in a_whole.iter().zip(b_whole) {
        for i in 0..8 {
            lanes[i] += a[i] * b[i];
        }
    }
    let halves =
        [lanes[0] + lanes[4], lanes[1] + lanes[5], lanes[2] + lanes[6], lanes[3] + lanes[7]];
    let whole = (halves[0] + halves[2]) + (halves[1] + halves[3]);
    a_rest.iter().zip(b_rest).fold(whole, |sum, (a, b)| sum + a * b)
}

pub(super) fn add_scaled(out: &mut [f32], factor: f32, values: &[f32]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += factor * value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::gradient_check::{assert_gradient, random};

    const SHAPE: AttentionShape = AttentionShape { width: 8, heads: 2 };
    const QUERIES: usize = 3;
    const ROWS: usize = 4;

    /// The first query sees two rows, the second nothing, the third everything.
    fn lists() -> VisibleLists {
        let mut lists = VisibleLists::default();
        for list in [&[0, 2][..], &[], &[0, 1, 2, 3]] {
            list.iter().for_each(|row| lists.push(*row));
            lists.end_list();
        }
        lists
    }

    fn run(queries: &[f32], keys_values: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let mut weights = vec![f32::NAN; lists().pairs() * SHAPE.heads];
        let mut output = vec![f32::NAN; QUERIES * SHAPE.width];
        forward(SHAPE, &lists(), queries, keys_values, &mut weights, &mut output);
        (weights, output)
    }

    #[test]
    fn weights_of_a_list_sum_to_one_and_an_empty_list_gives_zeros() {
        let (weights, output) =
            run(&random(1, QUERIES * SHAPE.width), &random(2, ROWS * 2 * SHAPE.width));
        for list in [&weights[..4], &weights[4..]] {
            for head in 0..2 {
                let sum: f32 = list.iter().skip(head).step_by(2).sum();
                assert!((sum - 1.0).abs() < 1e-6);
            }
        }
        assert_eq!(output[8..16], [0.0; 8]);
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let queries = random(1, QUERIES * SHAPE.width);
        let keys_values = random(2, ROWS * 2 * SHAPE.width);
        let d_output = random(3, QUERIES * SHAPE.width);
        let loss = |queries: &[f32], keys_values: &[f32]| {
            let (_, output) = run(queries, keys_values);
            output.iter().zip(&d_output).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
        };
        let (weights, _) = run(&queries, &keys_values);
        let mut d_queries = vec![f32::NAN; queries.len()];
        let mut d_keys_values = vec![f32::NAN; keys_values.len()];
        backward(
            SHAPE,
            &lists(),
            Backward {
                queries: &queries,
                keys_values: &keys_values,
                weights: &weights,
                d_output: &d_output,
                d_scores: &mut [0.0; ROWS * 2],
                d_queries: &mut d_queries,
                d_keys_values: &mut d_keys_values,
            },
        );
        assert_gradient("queries", &queries, &d_queries, |queries| loss(queries, &keys_values));
        assert_gradient("keys and values", &keys_values, &d_keys_values, |keys_values| {
            loss(&queries, keys_values)
        });
    }
}
