//! Policies made for tests.

use std::vec;
use std::vec::Vec;

use super::{Random, Sizes, assemble, with_header};
use crate::DecideError;
use crate::kernels::build::Build;
use crate::kernels::product::padded;
use crate::ops::{Input, Meaning, Op, Output, OutputRows, Place};
use crate::plan::{AlignedBytes, Network, Plan, PlanError, Profile, ProgramDraft};

/// A policy that is being built.
#[derive(Default)]
pub(super) struct Draft {
    pub(super) program: ProgramDraft,
    pub(super) weights: Vec<f32>,
    pub(super) hidden: u32,
    pub(super) actions: u32,
    /// Whether layers have int8 weights.
    pub(super) int8: bool,
}

impl Draft {
    pub(super) fn place(&mut self, len: usize) -> Place {
        let place = Place { offset: self.program.floats, len: len as u32 };
        self.program.floats += padded(len) as u32;
        place
    }

    pub(super) fn push(&mut self, op: Op) {
        self.program.ops.push(op);
    }

    pub(super) fn input(&mut self, len: usize) -> Place {
        self.observed(Meaning::None, len)
    }

    pub(super) fn observed(&mut self, meaning: Meaning, len: usize) -> Place {
        let to = self.place(len);
        let index = self.program.ops.iter().filter(|op| matches!(op, Op::Input(_))).count() as u16;
        self.push(Op::Input(Input { index, meaning, to }));
        to
    }

    pub(super) fn output(&mut self, from: Place) {
        let from_padded = Place { len: padded(from.len as usize) as u32, ..from };
        let (width, rows, groups) = (from.len, OutputRows::One, 0);
        self.push(Op::Output(Output { from: from_padded, width, rows, groups }));
    }

    pub(super) fn weights(&mut self, numbers: &[f32]) -> u32 {
        let start = self.weights.len() as u32;
        self.weights.extend(numbers);
        start
    }

    pub(super) fn bytes(&self) -> AlignedBytes {
        let actions = self.actions.max(1) as usize;
        let sizes = Sizes { n_max: 1, features: 1, actions, ..SIZES };
        let profile = if self.int8 { Profile::Int8 } else { Profile::Exact };
        let bytes = assemble(sizes, profile, &self.program, &self.weights);
        with_header(bytes.as_slice(), |header| {
            (header.network, header.hidden) = (Network::Policy, self.hidden);
        })
    }

    pub(super) fn refused(&self) -> Option<PlanError> {
        Plan::load(self.bytes().as_slice()).err()
    }

    /// The only output, the same on every build.
    pub(super) fn respond(&self, inputs: &[&[f32]], len: usize) -> Result<Vec<f32>, DecideError> {
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

pub(super) fn assert_close(got: &[f32], want: &[f64], what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (got, want) in got.iter().zip(want) {
        let error = (f64::from(*got) - want).abs();
        assert!(error <= 1e-6 * (1.0 + want.abs()), "{what}: {got}, want {want}");
    }
}

pub(super) fn numbers(random: &mut Random, count: usize) -> Vec<f32> {
    (0..count).map(|_| random.within(3.0)).collect()
}

/// Runs one step from inputs of these lengths to a value of that length.
pub(super) fn step(
    inputs: &[&[f32]],
    len: usize,
    op: impl FnOnce(&[Place], Place) -> Op,
) -> Vec<f32> {
    let mut draft = Draft::default();
    let from: Vec<Place> = inputs.iter().map(|input| draft.input(input.len())).collect();
    let to = draft.place(len);
    draft.push(op(&from, to));
    draft.output(to);
    draft.respond(inputs, len).unwrap()
}
