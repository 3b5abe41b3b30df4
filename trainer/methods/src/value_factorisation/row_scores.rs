//! Scores of rows by rows, each a query and a key: what attention looks up where few rows make many pairs.

use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};

use super::split_attention::HEADS;

/// The columns of each head.
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
