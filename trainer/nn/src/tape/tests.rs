use super::*;
use crate::gradient_check::{assert_gradient, random};
use crate::layers::unfold::UnfoldShape;
use crate::random::stream;

/// A loss of every number that `network` computes from a leaf, and its slopes by leaf and parameters.
fn descend(
    parameters: &[f32],
    (columns, x): (usize, &[f32]),
    network: &impl Fn(&mut Pass<'_>, Var) -> Var,
) -> (f64, Vec<f32>, Vec<f32>) {
    let mut tape = Tape::default();
    let mut pass = tape.begin(parameters);
    let leaf = pass.leaf(columns, x);
    let y = network(&mut pass, leaf);
    let numbers = pass.values(y).len();
    let weights = pass.input(numbers, &random(77, numbers));
    let y = pass.reshape(y, numbers);
    let y = pass.multiply(y, weights);
    let values = pass.values(y).iter().map(|y| f64::from(*y)).sum();
    let loss = pass.sum_columns(y);
    let mut gradient = vec![0.0; parameters.len()];
    pass.backward(loss, &mut gradient);
    (values, pass.slopes(leaf).map_or(Vec::new(), <[f32]>::to_vec), gradient)
}

fn check(
    name: &str,
    parameters: &Parameters,
    (rows, columns): (usize, usize),
    network: impl Fn(&mut Pass<'_>, Var) -> Var,
) {
    let x = random(5, rows * columns);
    let values = &parameters.values;
    let (_, slopes, gradient) = descend(values, (columns, &x), &network);
    if !slopes.is_empty() {
        assert_gradient(name, &x, &slopes, |x| descend(values, (columns, x), &network).0);
    }
    if !values.is_empty() {
        let loss = |values: &[f32]| descend(values, (columns, &x), &network).0;
        assert_gradient(&format!("parameters of {name}"), values, &gradient, loss);
    }
}

#[test]
fn gradients_of_steps_without_parameters_agree_with_finite_differences() {
    let none = Parameters::default();
    let check = |name: &str, network: fn(&mut Pass<'_>, Var) -> Var| {
        check(name, &none, (6, 4), network);
    };
    check("relu", |t, x| t.relu(x));
    check("leaky relu", |t, x| t.leaky_relu(x, 0.1));
    check("tanh", |t, x| t.tanh(x));
    check("sigmoid", |t, x| t.sigmoid(x));
    check("exp", |t, x| t.exp(x));
    check("elu", |t, x| t.elu(x));
    check("softmax by groups", |t, x| t.softmax_by(x, &[2, 0, 2, 2, 1, 0], 3));
    check("softmax of softmax by groups", |t, x| {
        let once = t.softmax_by(x, &[0, 0, 1, 1, 1, 1], 2);
        let other = t.softmax_by(x, &[1, 0, 1, 0, 1, 0], 2);
        t.multiply(once, other)
    });
    check("means by groups", |t, x| t.mean_by(x, &[2, 0, 2, 2, 3, 0], 4));
    check("softmax", |t, x| t.softmax(x));
    check("log-softmax", |t, x| t.log_softmax(x));
    check("normalised rows", |t, x| t.normalise_rows(x));
    check("normalised rows that are used twice", |t, x| {
        let y = t.normalise_rows(x);
        t.multiply(x, y)
    });
    check("gather", |t, x| t.gather(x, &[3, 0, 3, 5]));
    check("scatter", |t, x| t.scatter(x, &[2, 0, 2, 2, 1, 0], 3));
    check("pick", |t, x| t.pick(x, &[0, 3, 1, 1, 2, 0]));
    check("picks that share numbers", |t, x| {
        let (first, second) = (t.pick(x, &[0, 3, 1, 1, 2, 0]), t.pick(x, &[0, 1, 1, 2, 2, 3]));
        t.multiply(first, second)
    });
    check("columns", |t, x| t.columns(x, 1..3));
    check("rows", |t, x| t.rows(x, 2..5));
    check("reshape", |t, x| t.reshape(x, 8));
    check("sum of rows", |t, x| t.sum_rows(x));
    check("mean of rows", |t, x| t.mean_rows(x));
    check("sums of columns", |t, x| t.sum_columns(x));
    check("scale", |t, x| t.scale(x, -1.5));
    check("offset", |t, x| t.offset(x, 0.7));
    check("absolute value", |t, x| t.abs(x));
    check("elu", |t, x| t.elu(x));
    check("exp", |t, x| t.exp(x));
    check("root", |t, x| {
        let squares = t.multiply(x, x);
        let positive = t.offset(squares, 0.1);
        t.root(positive)
    });
    check("clamp", |t, x| t.clamp(x, -0.4, 0.3));
    check("weighted sum", |t, x| t.weighted_sum(x, &random(6, 24)));
    check("product", |t, x| {
        let (first, second) = (t.rows(x, 0..4), t.columns(x, 1..3));
        let second = t.rows(second, 1..5);
        t.product(first, second)
    });
    check("transposed product", |t, x| {
        let (first, squares) = (t.rows(x, 0..2), t.multiply(x, x));
        t.product_transposed(first, squares)
    });
    check("concat", |t, x| {
        let (first, squares) = (t.columns(x, 0..1), t.multiply(x, x));
        t.concat(&[first, x, squares])
    });
    check("stack", |t, x| {
        let (first, squares) = (t.rows(x, 0..2), t.multiply(x, x));
        t.stack(&[first, x, squares])
    });
    check("add", |t, x| {
        let other = t.tanh(x);
        t.add(x, other)
    });
    check("add to every block", |t, x| {
        let (block, squares) = (t.rows(x, 1..3), t.multiply(x, x));
        let block = t.tanh(block);
        t.add(squares, block)
    });
    check("rows times numbers", |t, x| {
        let by = t.sum_columns(x);
        t.scale_rows(x, by)
    });
    check("dueling", |t, x| {
        let (value, advantages) = (t.columns(x, 0..1), t.columns(x, 1..4));
        t.dueling(value, advantages)
    });
    check("squared error", |t, x| t.squared_error(x, &random(6, 24), 0.5));
    check("huber", |t, x| t.huber(x, &random(6, 24), 2.0, 0.3));
    check("unfold", |t, x| {
        let shape = UnfoldShape { height: 3, width: 2, channels: 2, kernel: 2, stride: 1 };
        let pictures = t.reshape(x, 12);
        t.unfold(pictures, shape)
    });
}

#[test]
fn gradients_of_layers_agree_with_finite_differences() {
    let drawn = &mut stream(3, 1, 0);
    let mut p = Parameters::default();
    let layer = p.linear("layer", 4, 5, drawn);
    check("linear", &p, (6, 4), |t, x| t.linear(x, layer));
    check("rectified", &p, (6, 4), |t, x| t.linear_rectified(x, layer));

    let mut p = Parameters::default();
    let layers = [p.linear("layer", 4, 5, drawn), p.projection("added", 3, 5, drawn)];
    check("rectified sum", &p, (6, 4), |t, x| {
        let squares = t.multiply(x, x);
        let added = t.columns(squares, 1..4);
        t.linear_sum_rectified([x, added], layers)
    });

    let mut p = Parameters::default();
    let layer = p.projection("projection", 4, 5, drawn);
    check("projection", &p, (6, 4), |t, x| t.linear(x, layer));

    let mut p = Parameters::default();
    let layer = p.sparse_linear("sparse", [4, 5], 2.0, drawn);
    let mut rows = SparseRows::default();
    [[1.0, 0.0, 0.0, 2.0], [0.0, 0.5, 0.0, 0.0]].iter().for_each(|row| rows.push_dense(row));
    check("sparse", &p, (1, 1), |t, _| t.sparse_linear(&rows, layer));
    check("rectified sparse", &p, (1, 1), |t, _| t.sparse_linear_rectified(&rows, layer));

    let mut p = Parameters::default();
    let layer = p.gru("gru", 4, drawn);
    let carry = [true, true, false, true, true, true];
    check("gru", &p, (6, 4), |t, x| t.gru(x, layer, &carry, &mut random(8, 8)));

    let mut p = Parameters::default();
    let shape = UnfoldShape { height: 4, width: 3, channels: 2, kernel: 2, stride: 1 };
    let layer = p.linear("convolution", shape.patch(), 3, drawn);
    check("convolution", &p, (2, 24), |t, x| t.convolution(x, shape, layer));
}

/// Two lists for the same keys and values, as imagined passes have them.
#[test]
fn attention_goes_over_shared_keys_and_values() {
    let lists = |seen: [&[usize]; 3]| {
        let mut lists = VisibleLists::default();
        for seen in seen {
            seen.iter().for_each(|row| lists.push(*row));
            lists.end_list();
        }
        lists
    };
    let (own, others) = (lists([&[0, 1], &[1, 2, 3], &[]]), lists([&[2, 3], &[0], &[0, 1, 2, 3]]));
    let drawn = &mut stream(3, 1, 0);
    let mut p = Parameters::default();
    let (queries, keys_values) =
        (p.projection("queries", 8, 8, drawn), p.projection("keys_values", 8, 16, drawn));
    check("attention", &p, (4, 8), |t, x| {
        let acting = t.rows(x, 0..3);
        let (queries, keys_values) = (t.linear(acting, queries), t.linear(x, keys_values));
        let own = t.attention(queries, keys_values, &own, 2);
        let others = t.attention(queries, keys_values, &others, 2);
        t.concat(&[own, others])
    });
}

/// What four queries see among four rows, in two parts of which either or both may be empty: in lists, of all and of each part.
fn parts() -> (VisibleLists, [VisibleLists; 3]) {
    let seen: [[&[usize]; 2]; 4] = [[&[0, 1], &[2, 3]], [&[2], &[]], [&[], &[3, 1]], [&[], &[]]];
    let (mut split, mut lists) = (VisibleLists::default(), <[VisibleLists; 3]>::default());
    for [within, across] in seen {
        split.push_parts(within.iter().copied(), across.iter().copied());
        for (list, rows) in lists.iter_mut().zip([&[within, across].concat(), within, across]) {
            rows.iter().for_each(|row| list.push(*row));
            list.end_list();
        }
    }
    (split, lists)
}

#[test]
fn what_is_seen_in_parts_is_what_is_seen_at_once() {
    let (split, lists) = parts();
    let (queries, keys_values) = (random(1, 4 * 16), random(2, 4 * 32));
    let mut tape = Tape::default();
    let mut t = tape.begin(&[]);
    let (queries, keys_values) = (t.input(16, &queries), t.input(32, &keys_values));
    let want = lists.map(|list| t.attention(queries, keys_values, &list, 4));
    let want = t.stack(&want);
    let found = t.split_attention(queries, keys_values, &split);
    assert_eq!(t.size(found), [12, 16]);
    let numbers = t.values(want).iter().zip(t.values(found));
    numbers.for_each(|(want, found)| assert!((want - found).abs() < 1e-6, "{want} {found}"));
}

#[test]
fn gradients_of_attention_in_parts_agree_with_finite_differences() {
    let (split, _) = parts();
    let drawn = &mut stream(3, 1, 0);
    let mut p = Parameters::default();
    let (queries, keys_values) =
        (p.projection("queries", 16, 16, drawn), p.projection("keys_values", 16, 32, drawn));
    // Once, and twice with the same queries, keys and values.
    for times in [1, 2] {
        check("attention in parts", &p, (4, 16), |t, x| {
            let (queries, keys_values) = (t.linear(x, queries), t.linear(x, keys_values));
            let all = [(); 2].map(|()| t.split_attention(queries, keys_values, &split));
            t.stack(&all[..times])
        });
    }
}

/// A linear layer whose weight is a product of two, and what queries and rows give in teams.
#[test]
fn products_of_parameters_and_steps_of_teams_have_their_gradients() {
    let drawn = &mut stream(3, 1, 0);
    let mut p = Parameters::default();
    let (first, last) = (p.projection("first", 4, 8, drawn), p.projection("last", 8, 3, drawn));
    let bias = p.tensor("bias", &[1, 3], 1.0, drawn);
    check("product of parameters", &p, (6, 4), |t, x| {
        let (first, last) = (t.parameter(first.weight, [8, 4]), t.parameter(last.weight, [3, 8]));
        let both = t.product(last, first);
        let (y, ones, bias) = (
            t.product_transposed(x, both),
            t.input(1, &[1.0, 2.0, 1.0, 0.5, 1.0, 0.0]),
            t.parameter(bias, [1, 3]),
        );
        let offsets = t.product(ones, bias);
        t.add(y, offsets)
    });

    let mut p = Parameters::default();
    let (queries, keys) = (p.projection("queries", 8, 8, drawn), p.projection("keys", 8, 8, drawn));
    let mut teams = TeamLists::default();
    for (size, seen) in [(2, &[0, 1, 3][..]), (0, &[0]), (1, &[2, 3]), (1, &[])] {
        seen.iter().for_each(|row| teams.push(*row));
        teams.end_team(size);
    }
    for sums in [Sums::PerQuery, Sums::PerTeam] {
        check("teams", &p, (5, 8), |t, x| {
            let acting = t.rows(x, 0..4);
            let (queries, keys) = (t.linear(acting, queries), t.linear(x, keys));
            t.team_attention([queries, keys, x], &teams, sums, 2)
        });
    }

    let mut p = Parameters::default();
    let matrices = p.projection("keys_values", 8, 16, drawn);
    let mut seen = VisibleLists::default();
    for list in [&[0, 1, 3][..], &[], &[4, 2]] {
        list.iter().for_each(|row| seen.push(*row));
        seen.end_list();
    }
    check("absorbed", &p, (5, 8), |t, x| {
        let queries = t.rows(x, 0..3);
        t.absorbed_attention(queries, x, matrices, &seen, 2)
    });
    let mut tape = Tape::default();
    let mut pass = tape.begin(&p.values);
    let x = pass.input(8, &random(5, 40));
    let (queries, rows) = (pass.rows(x, 0..3), pass.linear(x, matrices));
    let [absorbed, plain] = [
        pass.absorbed_attention(queries, x, matrices, &seen, 2),
        pass.attention(queries, rows, &seen, 2),
    ];
    for (absorbed, plain) in pass.values(absorbed).iter().zip(pass.values(plain)) {
        assert!((absorbed - plain).abs() < 1e-5, "{absorbed} against {plain}");
    }
    // Keys and values of five rows, a score and a sum for each of five pairs; then what three queries absorb, and the
    // scores and sums of two heads.
    let (plain, absorbed) = (5 * 128 + 2 * 5 * 8, 2 * 3 * 64 + 2 * 5 * 2 * 8);
    assert_eq!(pass.operations(false), 2 * (plain + absorbed));
    assert_eq!(pass.operations(true), 3 * pass.operations(false));
}

#[test]
fn places_are_those_that_parameters_get() {
    let drawn = &mut stream(3, 1, 0);
    let (mut p, mut places) = (Parameters::default(), Places::default());
    assert_eq!(p.linear("linear", 4, 5, drawn), places.linear(4, 5));
    assert_eq!(p.projection("projection", 3, 2, drawn), places.projection(3, 2));
    assert_eq!(p.gru("gru", 4, drawn), places.gru(4));
    assert_eq!(p.tensor("tensor", &[2, 3], 1.0, drawn), places.numbers(6));
    assert_eq!(places.end, p.values.len());
}

#[test]
fn squared_scores_are_those_of_each_query() {
    let mut lists = VisibleLists::default();
    for seen in [&[0, 1][..], &[1, 2, 3], &[]] {
        seen.iter().for_each(|row| lists.push(*row));
        lists.end_list();
    }
    let drawn = &mut stream(3, 1, 0);
    let mut p = Parameters::default();
    let (queries, keys_values) =
        (p.projection("queries", 8, 8, drawn), p.projection("keys_values", 8, 16, drawn));
    check("squared scores", &p, (4, 8), |t, x| {
        let acting = t.rows(x, 0..3);
        let (queries, keys_values) = (t.linear(acting, queries), t.linear(x, keys_values));
        t.squared_scores(queries, keys_values, &lists, 2)
    });
    // One query of two heads, (1, 2) and (3, 4), and a key of (5, 6) and (7, 8): 17 and 53.
    let mut tape = Tape::default();
    let mut pass = tape.begin(&[]);
    let query = pass.input(4, &[1.0, 2.0, 3.0, 4.0]);
    let key = pass.input(8, &[5.0, 6.0, 7.0, 8.0, 9.0, 9.0, 9.0, 9.0]);
    let mut one = VisibleLists::default();
    one.push(0);
    one.end_list();
    let sum = pass.squared_scores(query, key, &one, 2);
    assert_eq!(pass.values(sum), [17.0 * 17.0 + 53.0 * 53.0]);
}

#[test]
fn what_is_detached_gets_no_slopes() {
    let x = random(5, 8);
    let (_, slopes, _) = descend(&[], (4, &x), &|t: &mut Pass<'_>, x| {
        let fixed = t.detach(x);
        t.multiply(x, fixed)
    });
    let want: Vec<f32> = random(77, 8).iter().zip(&x).map(|(weight, x)| weight * x).collect();
    assert_eq!(slopes, want);
    assert!(descend(&[], (4, &x), &|t: &mut Pass<'_>, x| t.detach(x)).1.is_empty());
}

/// As where no agent sees anything that it could aim at.
#[test]
fn what_stands_beside_each_other_may_have_no_rows() {
    let (_, slopes, _) = descend(&[], (2, &random(5, 4)), &|t: &mut Pass<'_>, x| {
        let none = t.gather(x, &[]);
        let beside = t.concat(&[none, none]);
        let beside = t.reshape(beside, 2);
        t.scatter(beside, &[], 2)
    });
    assert_eq!(slopes, [0.0; 4]);
}

/// Though its memory is full of the slopes of the pass before.
#[test]
fn a_tape_that_was_used_finds_the_slopes_of_a_new_one() {
    let mut tape = Tape::default();
    for rows in [0..4, 1..3] {
        let mut pass = tape.begin(&[]);
        let x = pass.leaf(2, &random(5, 8));
        let part = pass.rows(x, rows.clone());
        let loss = pass.weighted_sum(part, &vec![3.0; 2 * rows.len()]);
        pass.backward(loss, &mut []);
        let want: Vec<f32> =
            (0..8).map(|at| if rows.contains(&(at / 2)) { 3.0 } else { 0.0 }).collect();
        assert_eq!(pass.slopes(x), Some(&want[..]), "{rows:?}");
    }
}

/// So that what layers make of numbers of any width is about as large as these.
#[test]
fn layers_are_drawn_by_the_root_of_what_they_take() {
    let (mut p, drawn) = (Parameters::default(), &mut stream(3, 1, 0));
    p.linear("linear", 4, 100, drawn);
    p.projection("projection", 16, 100, drawn);
    p.sparse_linear("sparse", [100, 20], 4.0, drawn);
    p.gru("memory", 16, drawn);
    for tensor in p.tensors() {
        let most =
            p.values[tensor.range.clone()].iter().fold(0.0, |most: f32, x| most.max(x.abs()));
        let narrow = ["projection", "memory"].iter().any(|name| tensor.name.starts_with(name));
        let bound = if narrow { 0.25 } else { 0.5 };
        assert!((0.75 * bound..bound).contains(&most), "{}: {most}", tensor.name);
    }
}

#[test]
fn tensors_have_names_shapes_and_places() {
    let mut p = Parameters::default();
    p.linear("fc", 3, 2, &mut stream(3, 1, 0));
    p.gru("memory", 2, &mut stream(3, 1, 0));
    let tensors: Vec<_> =
        p.tensors().iter().map(|t| (&*t.name, &*t.shape, t.range.clone())).collect();
    assert_eq!(
        tensors[..3],
        [
            ("fc.weight", &[2, 3][..], 0..6),
            ("fc.bias", &[2], 6..8),
            ("memory.weight_ih", &[6, 2], 8..20),
        ]
    );
    assert_eq!(p.values.len(), 8 + 24 + 12);
}

/// A pass that only looks finds the same numbers, on a tape where another one went back before, and has no way back.
#[test]
fn a_pass_that_only_looks_finds_the_same() {
    let mut parameters = Parameters::default();
    let mut random = stream(3, 0, 0);
    let embed = parameters.sparse_linear("embed", [5, 8], 2.0, &mut random);
    let rows = |shift: usize| {
        let mut rows = SparseRows::default();
        for row in 0..4 {
            rows.push((row + shift) % 5, 1.5);
            rows.end_row();
        }
        rows
    };
    let mut seen = VisibleLists::default();
    for query in 0..2 {
        (query..4).for_each(|row| seen.push(row));
        seen.end_list();
    }
    let look = |pass: &mut Pass<'_>, rows: &SparseRows| {
        let embedded = pass.sparse_linear_rectified(rows, embed);
        let (own, both) = (pass.rows(embedded, 0..2), pass.concat(&[embedded, embedded]));
        let attended = pass.attention(own, both, &seen, 2);
        let weights = pass.attention_weights(attended).unwrap().to_vec();
        (attended, (pass.values(attended).to_vec(), weights, pass.operations(false)))
    };
    let mut tape = Tape::default();
    let wanted = look(&mut tape.begin(&parameters.values), &rows(1)).1;
    // Its rows and lists stay in the tape's memory.
    look(&mut tape.begin(&parameters.values), &rows(2));
    let mut pass = tape.begin_forward(&parameters.values);
    let (attended, found) = look(&mut pass, &rows(1));
    assert_eq!(found, wanted);
    let loss = pass.weighted_sum(attended, &[1.0; 16]);
    let back = std::panic::AssertUnwindSafe(|| pass.backward(loss, &mut [0.0; 100]));
    assert!(std::panic::catch_unwind(back).is_err());
}
