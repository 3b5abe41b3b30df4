//! Every step of a policy against plain arithmetic.

use std::vec;
use std::vec::Vec;

use super::Random;
use super::drafts::{Draft, assert_close, numbers, step};
use crate::ops::{
    Arrange, Combination, Combine, Flag, Function, Map, Multiply, Normalise, Op, Place, Reduce,
    Reduction, Select, Softmax,
};

#[test]
fn functions_are_what_they_are_called() {
    let softplus = |x: f64| x.exp().ln_1p();
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    type Reference = fn(f64) -> f64;
    let functions: [(Function, f32, f32, Reference); 21] = [
        (Function::Affine, 2.0, -1.5, |x| 2.0 * x - 1.5),
        (Function::Relu, 0.0, 0.0, |x| x.max(0.0)),
        (Function::LeakyRelu, 0.01, 0.0, |x| if x > 0.0 { x } else { f64::from(0.01_f32) * x }),
        (Function::Elu, 1.5, 0.0, |x| if x > 0.0 { x } else { 1.5 * x.exp_m1() }),
        (Function::Tanh, 0.0, 0.0, f64::tanh),
        (Function::Sigmoid, 0.0, 0.0, |x| 1.0 / (1.0 + (-x).exp())),
        (Function::Softplus, 0.0, 0.0, |x| x.exp().ln_1p()),
        (Function::Softsign, 0.0, 0.0, |x| x / (1.0 + x.abs())),
        (Function::Silu, 0.0, 0.0, |x| x / (1.0 + (-x).exp())),
        (Function::Clip, -1.0, 0.75, |x| x.clamp(-1.0, 0.75)),
        (Function::Exp, 0.0, 0.0, f64::exp),
        (Function::Absolute, 0.0, 0.0, f64::abs),
        (Function::Reciprocal, 0.0, 0.0, |x| 1.0 / x),
        (Function::Not, 0.0, 0.0, |x| if x == 0.0 { 1.0 } else { 0.0 }),
        (Function::Floor, 0.0, 0.0, f64::floor),
        (Function::Round, 0.0, 0.0, f64::round_ties_even),
        (Function::Sign, 0.0, 0.0, f64::signum),
        (Function::Sine, 0.0, 0.0, f64::sin),
        (Function::Cosine, 0.0, 0.0, f64::cos),
        (Function::ArcTangent, 0.0, 0.0, f64::atan),
        (Function::Truncate, 0.0, 0.0, f64::trunc),
    ];
    let mut random = Random(3);
    for (function, a, b, reference) in functions {
        let mut x = numbers(&mut random, 37);
        if function == Function::Not {
            x[3] = 0.0;
        }
        let (a, b) = (a.to_bits(), b.to_bits());
        let want: Vec<f64> = x.iter().map(|x| reference(f64::from(*x))).collect();
        let map = |from, to| Op::Map(Map { function, a, b, from, to });
        assert_close(&step(&[&x], 37, |from, to| map(from[0], to)), &want, "apart");
        let mut draft = Draft::default();
        let place = draft.input(37);
        draft.push(map(place, place));
        draft.output(place);
        assert_close(&draft.respond(&[&x], 37).unwrap(), &want, "in place");
    }
    for x in [-90.0, -20.0, -0.2, -1e-6, 0.0, 1e-6, 0.2, 20.0, 80.0_f32] {
        let one = |function| {
            let map = |from: &[Place], to| Op::Map(Map { function, a: 0, b: 0, from: from[0], to });
            step(&[&[x]], 1, map)
        };
        let wide = f64::from(x);
        assert_close(&one(Function::Softplus), &[softplus(wide)], "softplus");
        assert_close(&one(Function::Silu), &[wide * sigmoid(wide)], "silu");
        let far = 1000.0 * x;
        let of_far = |function| {
            let map = |from: &[Place], to| Op::Map(Map { function, a: 0, b: 0, from: from[0], to });
            step(&[&[far]], 1, map)
        };
        assert_close(&of_far(Function::Sine), &[f64::from(far).sin()], "sine");
        assert_close(&of_far(Function::Cosine), &[f64::from(far).cos()], "cosine");
        assert_close(&of_far(Function::ArcTangent), &[f64::from(far).atan()], "arc tangent");
        if x > 0.0 {
            assert_close(&one(Function::Ln), &[wide.ln()], "ln");
            assert_close(&one(Function::Sqrt), &[wide.sqrt()], "sqrt");
        }
    }
}

#[test]
fn two_values_are_combined_number_by_number() {
    let number = |holds: bool| f64::from(u8::from(holds));
    type Reference = fn(f64, f64) -> f64;
    let combinations: [(Combination, Reference); 8] = [
        (Combination::Add, |x, y| x + y),
        (Combination::Subtract, |x, y| x - y),
        (Combination::Multiply, |x, y| x * y),
        (Combination::Divide, |x, y| x / y),
        (Combination::Minimum, f64::min),
        (Combination::Maximum, f64::max),
        (Combination::Less, |x, y| f64::from(u8::from(x < y))),
        (Combination::LessOrEqual, |x, y| f64::from(u8::from(x <= y))),
    ];
    let mut random = Random(4);
    for (combination, reference) in combinations {
        for right_len in [19, 1] {
            let (x, y) = (numbers(&mut random, 19), numbers(&mut random, right_len));
            let got = step(&[&x, &y], 19, |from, to| {
                Op::Combine(Combine { combination, left: from[0], right: from[1], to })
            });
            let right = |index: usize| f64::from(y[index % right_len]);
            let want: Vec<f64> =
                x.iter().enumerate().map(|(i, x)| reference(f64::from(*x), right(i))).collect();
            assert_close(&got, &want, "combined");
        }
    }
    let (x, y) = ([0.0, 0.0, 2.0, 2.0], [0.0, 3.0, 0.0, 2.0]);
    for (combination, want) in [
        (Combination::Equal, [true, false, false, true]),
        (Combination::And, [false, false, false, true]),
        (Combination::Or, [false, true, true, true]),
    ] {
        let got = step(&[&x, &y], 4, |from, to| {
            Op::Combine(Combine { combination, left: from[0], right: from[1], to })
        });
        assert_close(&got, &want.map(number), "logic");
    }
    let got = step(&[&[1.0, 0.0, 2.0], &[5.0, 6.0, 7.0], &[-1.0]], 3, |from, to| {
        Op::Select(Select { condition: from[0], yes: from[1], no: from[2], to })
    });
    assert_eq!(got, [5.0, -1.0, 7.0]);
}

#[test]
fn numbers_are_arranged_anew() {
    let x: Vec<f32> = (0..24).map(|x| x as f32).collect();
    let arranged = |len, sizes, from_strides, to_strides| {
        step(&[&x], len, |from, to| {
            Op::Arrange(Arrange { from: from[0], to, sizes, from_strides, to_strides })
        })
    };
    // [2, 3, 4] with its last two dimensions exchanged.
    let got = arranged(24, [1, 2, 4, 3], [0, 12, 1, 4], [0, 12, 3, 1]);
    let want: Vec<f32> =
        (0..24).map(|to| (to / 12 * 12 + to % 3 * 4 + to / 3 % 4) as f32).collect();
    assert_eq!(got, want);
    // Rows 0 to 3 twice.
    let got = arranged(8, [1, 1, 2, 4], [0, 0, 0, 1], [0, 0, 4, 1]);
    assert_eq!(got, [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0]);
    // Two values beside each other.
    let mut draft = Draft::default();
    let (a, b) = (draft.input(2), draft.input(4));
    let to = draft.place(6);
    for (from, width, first) in [(a, 1, 0), (b, 2, 1)] {
        let to = Place { offset: to.offset + first, len: 6 - first };
        draft.push(Op::Arrange(Arrange {
            from,
            to,
            sizes: [1, 1, 2, width],
            from_strides: [0, 0, width, 1],
            to_strides: [0, 0, 3, 1],
        }));
    }
    draft.output(to);
    let got = draft.respond(&[&[1.0, 2.0], &[3.0, 4.0, 5.0, 6.0]], 6).unwrap();
    assert_eq!(got, [1.0, 3.0, 4.0, 2.0, 5.0, 6.0]);
}

#[test]
fn rows_are_reduced_weighed_and_normalised() {
    let mut random = Random(5);
    let (rows, columns) = (3, 21);
    let x = numbers(&mut random, rows * columns);
    let wide: Vec<f64> = x.iter().map(|x| f64::from(*x)).collect();
    type Reference = fn(&[f64]) -> f64;
    let reductions: [(Reduction, Reference); 4] = [
        (Reduction::Sum, |row| row.iter().sum()),
        (Reduction::Mean, |row| row.iter().sum::<f64>() / row.len() as f64),
        (Reduction::Maximum, |row| row.iter().copied().fold(f64::MIN, f64::max)),
        (Reduction::Minimum, |row| row.iter().copied().fold(f64::MAX, f64::min)),
    ];
    let reduce = |reduction, x: &[f32]| {
        step(&[x], rows, |from, to| {
            Op::Reduce(Reduce { reduction, columns: columns as u32, from: from[0], to })
        })
    };
    for (reduction, reference) in reductions {
        let want: Vec<f64> = wide.chunks(columns).map(reference).collect();
        assert_close(&reduce(reduction, &x), &want, "reduced");
    }
    let mut ties = vec![0.0; rows * columns];
    (ties[4], ties[7], ties[columns], ties[3 * columns - 1]) = (2.0, 2.0, 1.0, 9.0);
    assert_eq!(reduce(Reduction::ArgMax, &ties), [4.0, 0.0, 20.0]);

    for logarithm in [Flag::No, Flag::Yes] {
        let got = step(&[&x], x.len(), |from, to| {
            Op::Softmax(Softmax { logarithm, columns: columns as u32, from: from[0], to })
        });
        let weigh = |row: &[f64]| -> Vec<f64> {
            let sum: f64 = row.iter().map(|x| x.exp()).sum();
            let weights = row.iter().map(|x| x.exp() / sum);
            weights.map(|w| if logarithm.is_set() { w.ln() } else { w }).collect()
        };
        let want: Vec<f64> = wide.chunks(columns).flat_map(weigh).collect();
        assert_close(&got, &want, "softmax");
    }

    let (factors, offsets) = (numbers(&mut random, columns), numbers(&mut random, columns));
    for centred in [Flag::Yes, Flag::No] {
        let mut draft = Draft::default();
        let place = draft.input(x.len());
        let (of_factors, of_offsets) = (draft.weights(&factors), draft.weights(&offsets));
        draft.push(Op::Normalise(Normalise {
            centred,
            columns: columns as u32,
            epsilon: 1e-5_f32.to_bits(),
            factors: of_factors,
            offsets: of_offsets,
            from: place,
            to: place,
        }));
        draft.output(place);
        let normal = |row: &[f64]| -> Vec<f64> {
            let mean = row.iter().sum::<f64>() / columns as f64;
            let mean = if centred.is_set() { mean } else { 0.0 };
            let variance = row.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / columns as f64;
            let scale = 1.0 / (variance + f64::from(1e-5_f32)).sqrt();
            let columns = row.iter().zip(&factors).zip(&offsets);
            columns.map(|((x, f), o)| (x - mean) * scale * f64::from(*f) + f64::from(*o)).collect()
        };
        let want: Vec<f64> = wide.chunks(columns).flat_map(normal).collect();
        assert_close(&draft.respond(&[&x], x.len()).unwrap(), &want, "normalised");
    }
}

#[test]
fn matrices_are_multiplied() {
    let mut random = Random(6);
    // More rows than are worked on together, and more columns than fill a register.
    let (count, rows, inner, columns) = (2, 10, 5, 19);
    let left = numbers(&mut random, count * rows * inner);
    let right = numbers(&mut random, count * inner * columns);
    let got = step(&[&left, &right], count * rows * columns, |from, to| {
        let [rows, inner, columns] = [rows, inner, columns].map(|size| size as u32);
        Op::Multiply(Multiply { rows, inner, columns, left: from[0], right: from[1], to })
    });
    let mut want = Vec::new();
    for (left, right) in left.chunks(rows * inner).zip(right.chunks(inner * columns)) {
        for row in left.chunks(inner) {
            want.extend((0..columns).map(|column| {
                let products = row.iter().zip(right.iter().skip(column).step_by(columns));
                products.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
            }));
        }
    }
    assert_close(&got, &want, "product");
}
