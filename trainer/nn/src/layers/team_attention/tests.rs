use super::*;
use crate::gradient_check::{assert_gradient, random};

const SHAPES: [AttentionShape; 4] = [
    AttentionShape { width: 32, heads: 4 },
    AttentionShape { width: 64, heads: 4 },
    AttentionShape { width: 128, heads: 4 },
    AttentionShape { width: 6, heads: 3 },
];
const ROWS: usize = 5;

/// A team of two, one of nobody, one of one; the last two attend to rows of the first.
fn teams() -> TeamLists {
    let mut teams = TeamLists::default();
    for (queries, list) in [(2, &[0, 1, 3][..]), (0, &[0]), (1, &[2, 3, 4, 0])] {
        list.iter().for_each(|row| teams.push(*row));
        teams.end_team(queries);
    }
    teams
}

fn run(shape: AttentionShape, sums: Sums, tensors: [&[f32]; 3]) -> (Vec<f32>, Vec<f32>) {
    let teams = teams();
    let mut weights = vec![f32::NAN; teams.pairs() * shape.heads];
    let mut out = vec![f32::NAN; sums.count(&teams) * shape.heads * shape.width];
    let [queries, keys, rows] = tensors;
    let pass = Forward { queries, keys, rows, weights: &mut weights, sums: &mut out };
    forward(shape, &teams, sums, pass);
    (weights, out)
}

#[test]
fn a_sum_of_a_team_is_the_sum_of_its_queries() {
    for shape in SHAPES {
        let tensors = [random(1, 3 * shape.width), random(2, ROWS * shape.width)];
        let rows = random(3, ROWS * shape.width);
        let tensors = [&*tensors[0], &tensors[1], &rows];
        let (per_query, per_team) =
            (run(shape, Sums::PerQuery, tensors).1, run(shape, Sums::PerTeam, tensors).1);
        let wide = shape.heads * shape.width;
        for (i, got) in per_team.iter().enumerate() {
            let want = match i / wide {
                0 => per_query[i] + per_query[i + wide],
                1 => 0.0,
                _ => per_query[i],
            };
            assert!((got - want).abs() < 1e-5, "{got} against {want}");
        }
    }
}

#[test]
fn gradients_agree_with_finite_differences() {
    for (shape, sums) in
        SHAPES.into_iter().flat_map(|shape| [(shape, Sums::PerQuery), (shape, Sums::PerTeam)])
    {
        let queries = random(1, 3 * shape.width);
        let (keys, rows) = (random(2, ROWS * shape.width), random(3, ROWS * shape.width));
        let d_sums = random(4, sums.count(&teams()) * shape.heads * shape.width);
        let loss = |tensors: [&[f32]; 3]| {
            let (_, out) = run(shape, sums, tensors);
            out.iter().zip(&d_sums).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
        };
        let (weights, _) = run(shape, sums, [&queries, &keys, &rows]);
        let mut d_queries = vec![f32::NAN; queries.len()];
        let (mut d_keys, mut d_rows) = (vec![f32::NAN; keys.len()], vec![f32::NAN; rows.len()]);
        let pass = Backward {
            queries: &queries,
            keys: &keys,
            rows: &rows,
            weights: &weights,
            d_sums: &d_sums,
            d_queries: &mut d_queries,
            d_keys: &mut d_keys,
            d_rows: &mut d_rows,
        };
        backward(shape, &teams(), sums, pass);
        assert_gradient("queries", &queries, &d_queries, |x| loss([x, &keys, &rows]));
        assert_gradient("keys", &keys, &d_keys, |x| loss([&queries, x, &rows]));
        assert_gradient("rows", &rows, &d_rows, |x| loss([&queries, &keys, x]));
    }
}
