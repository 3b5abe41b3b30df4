//! Policies of general steps: every step against plain arithmetic, and programs that do not hold together.

use std::vec;
use std::vec::Vec;

use super::{Random, Sizes, assemble, with_header};
use crate::DecideError;
use crate::kernels::build::Build;
use crate::kernels::product::padded;
use crate::ops::{
    AllOperators, Arrange, Combination, Combine, Constant, Dense, Flag, Function, Gru, Input,
    Linear, Map, MaskedArgmax, MaskedSample, Multiply, Normalise, Op, Output, OutputRows, Place,
    Reduce, Reduction, Select, Softmax, State,
};
use crate::plan::{AlignedBytes, Given, Network, Plan, PlanError, Profile, Program, ProgramDraft};

/// A policy that is being built.
#[derive(Default)]
struct Draft {
    program: ProgramDraft,
    weights: Vec<f32>,
    hidden: u32,
    actions: u32,
}

impl Draft {
    fn place(&mut self, len: usize) -> Place {
        let place = Place { offset: self.program.floats, len: len as u32 };
        self.program.floats += padded(len) as u32;
        place
    }

    fn push(&mut self, op: Op) {
        self.program.ops.push(op);
    }

    fn input(&mut self, len: usize) -> Place {
        let to = self.place(len);
        let index = self.program.ops.iter().filter(|op| matches!(op, Op::Input(_))).count() as u32;
        self.push(Op::Input(Input { index, to }));
        to
    }

    fn output(&mut self, from: Place) {
        let from_padded = Place { len: padded(from.len as usize) as u32, ..from };
        let (width, rows, groups) = (from.len, OutputRows::One, 0);
        self.push(Op::Output(Output { from: from_padded, width, rows, groups }));
    }

    fn weights(&mut self, numbers: &[f32]) -> u32 {
        let start = self.weights.len() as u32;
        self.weights.extend(numbers);
        start
    }

    fn bytes(&self) -> AlignedBytes {
        let actions = self.actions.max(1) as usize;
        let sizes = Sizes { n_max: 1, features: 1, actions, ..SIZES };
        let bytes = assemble(sizes, Profile::Exact, &self.program, &self.weights);
        with_header(bytes.as_slice(), |header| {
            (header.network, header.hidden) = (Network::Policy, self.hidden);
        })
    }

    fn refused(&self) -> Option<PlanError> {
        Plan::load(self.bytes().as_slice()).err()
    }

    /// The only output, the same on every build.
    fn respond(&self, inputs: &[&[f32]], len: usize) -> Result<Vec<f32>, DecideError> {
        let bytes = self.bytes();
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let answers = Build::all().map(|build| {
            let plan = plan.clone().on(build);
            // What the arena held before does not matter.
            let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
            arena.as_mut_slice().fill(0xFF);
            let mut answer = vec![f32::NAN; len];
            let mut states = vec![0.5; plan.hidden()];
            let outputs = &mut [answer.as_mut_slice()];
            plan.respond(arena.as_mut_slice(), inputs, &mut states, outputs).map(|()| answer)
        });
        let answers: Vec<_> = answers.collect();
        let bits = |answer: &Result<Vec<f32>, _>| {
            answer.clone().map(|answer| answer.iter().map(|x| x.to_bits()).collect::<Vec<_>>())
        };
        assert!(answers.iter().all(|answer| bits(answer) == bits(&answers[0])), "{answers:?}");
        answers[0].clone()
    }
}

const SIZES: Sizes = Sizes {
    n_max: 1,
    features: 1,
    actions: 1,
    last_action: false,
    width: 8,
    heads: 1,
    head: 8,
    base: 8,
    skip: 0,
};

fn assert_close(got: &[f32], want: &[f64], what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (got, want) in got.iter().zip(want) {
        let error = (f64::from(*got) - want).abs();
        assert!(error <= 1e-6 * (1.0 + want.abs()), "{what}: {got}, want {want}");
    }
}

fn numbers(random: &mut Random, count: usize) -> Vec<f32> {
    (0..count).map(|_| random.within(3.0)).collect()
}

/// Runs one step from inputs of these lengths to a value of that length.
fn step(inputs: &[&[f32]], len: usize, op: impl FnOnce(&[Place], Place) -> Op) -> Vec<f32> {
    let mut draft = Draft::default();
    let from: Vec<Place> = inputs.iter().map(|input| draft.input(input.len())).collect();
    let to = draft.place(len);
    draft.push(op(&from, to));
    draft.output(to);
    draft.respond(inputs, len).unwrap()
}

#[test]
fn functions_are_what_they_are_called() {
    let softplus = |x: f64| x.exp().ln_1p();
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    type Reference = fn(f64) -> f64;
    let functions: [(Function, f32, f32, Reference); 14] = [
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
    let (count, rows, inner, columns) = (2, 3, 5, 4);
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

/// A layer, a constant that is added, a choice; and a state that counts what it is given.
fn counting() -> Draft {
    let mut draft = Draft { hidden: 2, actions: 3, ..Draft::default() };
    let observation = draft.input(2);
    let state = draft.place(2);
    let next = draft.place(2);
    draft.push(Op::State(State { from: state, to: next }));
    let (left, right) = (state, observation);
    draft.push(Op::Combine(Combine { combination: Combination::Add, left, right, to: next }));
    let mut matrix = [0.0; 2 * 8];
    (matrix[0], matrix[9], matrix[2]) = (1.0, 1.0, 0.25);
    let layer = Linear {
        inputs: 2,
        outputs: 3,
        weights: draft.weights(&matrix),
        bias: draft.weights(&[0.0; 8]),
    };
    let to = draft.place(8);
    let (relu, sparse_input) = (Flag::No, Flag::No);
    draft.push(Op::Dense(Dense { layer, relu, sparse_input, from: next, to }));
    let constant = draft.place(3);
    let weights = draft.weights(&[0.0, 0.0, 1.0]);
    draft.push(Op::Constant(Constant { weights, to: constant }));
    let utilities = Place { len: 3, ..to };
    let combination = Combination::Add;
    draft.push(Op::Combine(Combine {
        combination,
        left: utilities,
        right: constant,
        to: utilities,
    }));
    draft.push(Op::MaskedArgmax(MaskedArgmax { from: utilities }));
    draft
}

#[test]
fn a_policy_chooses_and_remembers() {
    let bytes = counting().bytes();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let arena = arena.as_mut_slice();
    let mut states = [0.0; 2];
    let mut choose = |inputs: &[f32], available: &[u16], states: &mut [f32]| {
        let given = Given { inputs: &[inputs], available };
        plan.choose(arena, &given, states).map(|decision| (decision.action, decision.utility))
    };
    assert_eq!(choose(&[0.5, 0.0], &[1; 3], &mut states), Ok((2, 1.125)));
    assert_eq!(choose(&[0.0, 2.0], &[1; 3], &mut states), Ok((1, 2.0)));
    assert_eq!(choose(&[0.0, 0.0], &[1, 0, 0], &mut states), Ok((0, 0.5)));
    assert_eq!(states, [0.5, 2.0]);
    // Whatever goes wrong, nothing is remembered of it.
    let refused = [
        (choose(&[f32::NAN, 0.0], &[1; 3], &mut states), DecideError::NonFinite),
        (choose(&[1.0, 0.0], &[0; 3], &mut states), DecideError::NoAvailableAction),
        (choose(&[1.0], &[1; 3], &mut states), DecideError::BadLength),
        (choose(&[f32::MAX, 0.0], &[1; 3], &mut [f32::MAX, 0.0]), DecideError::NonFinite),
        (choose(&[1.0, 0.0], &[1; 3], &mut [0.0]), DecideError::HiddenState { want: 2, got: 1 }),
        (choose(&[1.0, 0.0], &[1; 3], &mut [f32::NAN, 0.0]), DecideError::NonFinite),
    ];
    for (got, want) in refused {
        assert_eq!(got, Err(want));
    }
    assert_eq!(states, [0.5, 2.0]);
    let given = Given { inputs: &[&[0.0; 2]], available: &[1; 3] };
    assert_eq!(plan.draw(arena, &given, &mut states, 1), Err(DecideError::Greedy));
    assert_eq!(
        plan.respond(arena, given.inputs, &mut states, &mut []),
        Err(DecideError::BadLength)
    );
}

#[test]
fn of_several_states_all_are_remembered_or_none() {
    let mut draft = Draft { hidden: 2, ..Draft::default() };
    let x = draft.input(1);
    for factor in [1.0_f32, f32::MAX] {
        let (from, to) = (draft.place(1), draft.place(1));
        draft.program.ops.insert(1, Op::State(State { from, to }));
        let (a, b) = (factor.to_bits(), 0);
        draft.push(Op::Map(Map { function: Function::Affine, a, b, from: x, to }));
    }
    // The state that overflows is the caller's second.
    draft.program.ops.swap(1, 2);
    draft.output(x);
    let bytes = draft.bytes();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let (mut states, mut output) = ([7.0, 8.0], [0.0]);
    let mut respond = |x: f32, states: &mut [f32]| {
        plan.respond(arena.as_mut_slice(), &[&[x]], states, &mut [&mut output])
    };
    assert_eq!(respond(2.0, &mut states), Err(DecideError::NonFinite));
    assert_eq!(states, [7.0, 8.0]);
    assert_eq!(respond(1.0, &mut states), Ok(()));
    assert_eq!(states, [1.0, f32::MAX]);
}

#[test]
fn a_policy_draws_from_its_logits() {
    let mut draft = Draft { actions: 3, ..Draft::default() };
    let from = draft.input(3);
    draft.push(Op::MaskedSample(MaskedSample { from }));
    let bytes = draft.bytes();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let given = Given { inputs: &[&[0.0, 9.0, 0.0]], available: &[1, 0, 1] };
    let mut draw =
        |random| plan.draw(arena.as_mut_slice(), &given, &mut [], random).unwrap().action;
    assert_eq!([draw(0), draw(u32::MAX)], [0, 2]);
}

#[test]
fn programs_that_do_not_hold_together_are_refused() {
    let changed = |change: fn(&mut Vec<Op>)| {
        let mut draft = counting();
        change(&mut draft.program.ops);
        draft.refused()
    };
    let mismatch = |op| Some(PlanError::ShapeMismatch { op });
    assert_eq!(changed(|_| ()), None);
    // The sum before what it adds; the layer before its input.
    assert_eq!(changed(|ops| ops.swap(0, 2)), mismatch(0));
    assert_eq!(changed(|ops| ops.swap(2, 3)), mismatch(2));
    assert_eq!(changed(|ops| _ = ops.remove(4)), mismatch(4));
    // An input behind the steps, a step behind the choice, no end, no input.
    assert_eq!(changed(|ops| ops.insert(3, ops[0])), mismatch(3));
    assert_eq!(changed(|ops| ops.push(ops[2])), mismatch(7));
    assert_eq!(changed(|ops| _ = ops.pop()), mismatch(6));
    assert_eq!(changed(|ops| _ = ops.remove(0)), mismatch(1));
    // A state that nobody writes, or that the header does not know.
    assert_eq!(changed(|ops| _ = ops.remove(1)), mismatch(1));
    let lonely = |ops: &mut Vec<Op>| {
        if let Op::State(state) = &mut ops[1] {
            state.to.offset = 88;
        }
    };
    let mut draft = counting();
    draft.program.floats += 64;
    lonely(&mut draft.program.ops);
    assert_eq!(draft.refused(), mismatch(7));
    assert_eq!(Draft { hidden: 3, ..counting() }.refused(), mismatch(7));
    // Inputs are numbered as they come.
    let numbered = changed(|ops| {
        if let Op::Input(input) = &mut ops[0] {
            input.index = 1;
        }
    });
    assert_eq!(numbered, mismatch(0));
    // A policy's steps stand in no agent's plan.
    let bytes = with_header(counting().bytes().as_slice(), |header| {
        (header.network, header.hidden) = (Network::Agent, 0);
    });
    assert_eq!(Plan::load(bytes.as_slice()).err(), mismatch(0));
    // More operators than a reader takes.
    let mut draft = counting();
    let sum = draft.program.ops[2];
    draft.program.ops.splice(2..2, vec![sum; 260]);
    let bytes = draft.program.to_bytes();
    assert_eq!(Program::<AllOperators>::read(bytes.as_slice()).err(), mismatch(256));
}

#[test]
fn steps_stay_inside_their_places() {
    let place = |offset, len| Place { offset, len };
    let (x, to) = (place(0, 8), place(16, 8));
    let map = |from, to| Op::Map(Map { function: Function::Relu, a: 0, b: 0, from, to });
    let combine =
        |left, right, to| Op::Combine(Combine { combination: Combination::Add, left, right, to });
    let arrange = |sizes, from_strides, to_strides| {
        Op::Arrange(Arrange { from: x, to, sizes, from_strides, to_strides })
    };
    let reduce =
        |columns, from, to| Op::Reduce(Reduce { reduction: Reduction::Sum, columns, from, to });
    let softmax =
        |columns, from, to| Op::Softmax(Softmax { logarithm: Flag::No, columns, from, to });
    let multiply = |[rows, inner, columns]: [u32; 3], left, right, to| {
        Op::Multiply(Multiply { rows, inner, columns, left, right, to })
    };
    let normalise = |columns, weights| {
        Op::Normalise(Normalise {
            centred: Flag::Yes,
            columns,
            epsilon: 0,
            factors: weights,
            offsets: 0,
            from: x,
            to,
        })
    };
    let gru = |size| {
        let layer = Linear { inputs: 8, outputs: 24, weights: 0, bias: 0 };
        Op::Gru(Gru {
            size,
            input: layer,
            recurrent: layer,
            sparse_input: Flag::No,
            from: x,
            state: x,
            input_gates: to,
            recurrent_gates: to,
            to,
        })
    };
    let wrong = [
        map(x, place(4, 8)),
        map(x, place(16, 7)),
        map(x, place(60, 8)),
        map(place(u32::MAX, 8), to),
        combine(x, place(8, 2), to),
        combine(x, to, to),
        combine(x, x, place(4, 8)),
        Op::Select(Select { condition: x, yes: x, no: to, to }),
        Op::Select(Select { condition: place(0, 1), yes: x, no: x, to }),
        arrange([1, 1, 1, 9], [0, 0, 0, 1], [0, 0, 0, 0]),
        arrange([1, 1, 1, 8], [0, 0, 0, 0], [0, 0, 0, 2]),
        arrange([0, 1, 1, 8], [0; 4], [0; 4]),
        arrange([u32::MAX; 4], [u32::MAX; 4], [0; 4]),
        reduce(0, x, place(16, 1)),
        reduce(4, x, place(16, 1)),
        reduce(8, x, place(0, 1)),
        softmax(0, x, to),
        softmax(3, x, to),
        multiply([2, 4, 1], x, place(0, 4), place(4, 2)),
        multiply([2, 4, 2], x, x, place(16, 2)),
        multiply([0, 0, 0], x, x, to),
        multiply([u32::MAX; 3], x, x, to),
        normalise(8, 64),
        normalise(0, 0),
        gru(u32::MAX),
        Op::Constant(Constant { weights: 60, to }),
        Op::Constant(Constant { weights: u32::MAX, to }),
        Op::Input(Input { index: 0, to: place(60, 8) }),
        Op::State(State { from: x, to: place(4, 8) }),
    ];
    for op in wrong {
        let mut draft = Draft { weights: vec![0.0; 64], ..Draft::default() };
        draft.program.floats = 64;
        draft.push(Op::Input(Input { index: 0, to: place(0, 8) }));
        draft.push(op);
        draft.push(Op::Constant(Constant { weights: 0, to: place(0, 64) }));
        assert_eq!(draft.refused(), Some(PlanError::ShapeMismatch { op: 1 }), "{op:?}");
    }
}
