use super::*;
use crate::gradient_check::{assert_gradient, random};

/// The usual sizes, and other numbers of heads.
const SHAPES: [AttentionShape; 5] = [
    AttentionShape { width: 32, heads: 4 },
    AttentionShape { width: 64, heads: 4 },
    AttentionShape { width: 128, heads: 4 },
    AttentionShape { width: 30, heads: 5 },
    AttentionShape { width: 8, heads: 2 },
];
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

fn run(shape: AttentionShape, queries: &[f32], keys_values: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let mut weights = vec![f32::NAN; lists().pairs() * shape.heads];
    let mut output = vec![f32::NAN; QUERIES * shape.width];
    let (of_pairs, shares, output_here) = (&mut *weights, &mut [][..], &mut *output);
    let pass = Forward { queries, keys_values, of_pairs, shares, output: output_here };
    forward(shape, &lists(), pass);
    (weights, output)
}

fn inputs(shape: AttentionShape) -> (Vec<f32>, Vec<f32>) {
    (random(1, QUERIES * shape.width), random(2, ROWS * 2 * shape.width))
}

#[test]
fn weights_of_a_list_sum_to_one_and_an_empty_list_gives_zeros() {
    for shape in SHAPES {
        let (queries, keys_values) = inputs(shape);
        let (weights, output) = run(shape, &queries, &keys_values);
        let (first, third) = weights.split_at(2 * shape.heads);
        for (list, head) in [first, third]
            .into_iter()
            .flat_map(|list| (0..shape.heads).map(move |head| (list, head)))
        {
            let sum: f32 = list.iter().skip(head).step_by(shape.heads).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{shape:?}");
        }
        assert!(output[shape.width..2 * shape.width].iter().all(|value| *value == 0.0));
    }
}

#[test]
fn gradients_agree_with_finite_differences() {
    for shape in SHAPES {
        let (queries, keys_values) = inputs(shape);
        let d_output = random(3, QUERIES * shape.width);
        let loss = |queries: &[f32], keys_values: &[f32]| {
            let (_, output) = run(shape, queries, keys_values);
            output.iter().zip(&d_output).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
        };
        let (weights, _) = run(shape, &queries, &keys_values);
        let mut d_queries = vec![f32::NAN; queries.len()];
        let mut d_keys_values = vec![f32::NAN; keys_values.len()];
        let pass = Backward {
            queries: &queries,
            keys_values: &keys_values,
            of_pairs: &weights,
            shares: &[],
            output: &[],
            d_output: &d_output,
            d_scores: &mut vec![0.0; ROWS * shape.heads],
            d_queries: &mut d_queries,
            d_keys_values: &mut d_keys_values,
        };
        backward(shape, &lists(), pass);
        assert_gradient("queries", &queries, &d_queries, |queries| loss(queries, &keys_values));
        assert_gradient("keys and values", &keys_values, &d_keys_values, |keys_values| {
            loss(&queries, keys_values)
        });
    }
}
