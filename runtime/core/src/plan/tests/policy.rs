//! Policies: what they remember, choose and draw, and programs that do not hold together.

use std::vec;
use std::vec::Vec;

use super::drafts::Draft;
use super::with_header;
use crate::DecideError;
use crate::ops::{
    AllOperators, Arrange, Combination, Combine, Constant, Dense, Flag, Function, Gru, Input,
    Linear, Map, MaskedArgmax, MaskedSample, Meaning, Multiply, Normalise, Op, Place, Reduce,
    Reduction, Select, Softmax, State,
};
use crate::plan::{AlignedBytes, Given, Network, OPS, Plan, PlanError, Program};

/// A layer, a constant that is added, a choice; and a state that counts what it is given.
pub(super) fn counting() -> Draft {
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
    draft.program.ops.splice(2..2, vec![sum; OPS]);
    let bytes = draft.program.to_bytes();
    assert_eq!(Program::<AllOperators>::read(bytes.as_slice()).err(), mismatch(OPS));
}

/// As the turns of a unit that goes backwards through a history are.
#[test]
fn parts_may_be_written_from_the_last_to_the_first() {
    const PARTS: u32 = 100;
    let mut draft = Draft { actions: 0, ..Draft::default() };
    let from = draft.input(8);
    let whole = draft.place(8 * PARTS as usize);
    for part in (0..PARTS).rev() {
        let to = Place { offset: whole.offset + 8 * part, len: 8 };
        draft.push(Op::Map(Map { function: Function::Relu, a: 0, b: 0, from, to }));
    }
    draft.output(whole);
    assert_eq!(draft.refused(), None);
    draft.program.ops.remove(50);
    assert_eq!(draft.refused(), Some(PlanError::ShapeMismatch { op: PARTS as usize }));
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
        Op::Input(Input { index: 0, meaning: Meaning::None, to: place(60, 8) }),
        Op::State(State { from: x, to: place(60, 8) }),
    ];
    for op in wrong {
        let mut draft = Draft { weights: vec![0.0; 64], ..Draft::default() };
        draft.program.floats = 64;
        draft.push(Op::Input(Input { index: 0, meaning: Meaning::None, to: place(0, 8) }));
        draft.push(op);
        draft.push(Op::Constant(Constant { weights: 0, to: place(0, 64) }));
        assert_eq!(draft.refused(), Some(PlanError::ShapeMismatch { op: 1 }), "{op:?}");
    }
}
