//! Plans of int8 weights: of random networks, and forged ones.

use std::vec::Vec;

use super::{Builder, Frame, Random, Sizes, alone, assemble};
use crate::kernels::product::padded;
use crate::ops::{
    Flag, Int8AttendOwn, Int8Dense, Int8EmbedEntities, Int8Layer, MaskedArgmax, Op, Place,
    quantised_floats,
};
use crate::plan::{
    AlignedBytes, HEADER_BYTES, Header, LAYOUT_TILES, Plan, PlanError, Profile, ProgramDraft,
    checksums,
};

/// Columns of steps and biases.
fn columns(outputs: usize) -> usize {
    outputs.next_multiple_of(16)
}

impl Builder<'_> {
    /// Matrices of int8 weights, one behind the other, and their steps.
    fn int8_matrices(&mut self, count: usize, inputs: usize, outputs: usize) -> (u32, u32) {
        let start = self.numbers(0, 0.0);
        let floats = count * inputs.div_ceil(8) * 4 * columns(outputs) / 2;
        let word =
            |random: &mut Random| (random.below(1 << 16) << 16 | random.below(1 << 16)) as u32;
        self.weights.extend((0..floats).map(|_| f32::from_bits(word(self.random))));
        (start, self.numbers(count * columns(outputs), 0.02 / (inputs as f32).sqrt()))
    }

    fn int8_layer(&mut self, inputs: usize, outputs: usize) -> Int8Layer {
        let (weights, steps) = self.int8_matrices(1, inputs, outputs);
        let bias = self.numbers(columns(outputs), 0.5);
        Int8Layer { inputs: inputs as u16, outputs: outputs as u16, weights, steps, bias }
    }
}

/// A plan of a random network.
pub(super) fn plan(sizes: Sizes, random: &mut Random) -> AlignedBytes {
    let (program, weights) = program(sizes, random);
    assemble(sizes, Profile::Int8, &program, &weights)
}

fn program(sizes: Sizes, random: &mut Random) -> (ProgramDraft, Vec<f32>) {
    let Sizes { n_max, features, actions, width, heads, base, skip, .. } = sizes;
    let head = padded(sizes.head);
    let mut build = Builder { random, weights: Vec::new(), floats: 0 };
    let rows = build.place((n_max + 1) * (quantised_floats(width) + 1));
    let last_actions = if sizes.last_action { actions } else { 0 };
    let embed = Int8EmbedEntities {
        layer: build.int8_layer(features + last_actions, width),
        last_actions: last_actions as u32,
        relu: Flag::Yes,
        rows,
        quantised: build.place(quantised_floats(features + last_actions)),
        embedded: build.place(width),
    };
    let (keys, key_steps) = build.int8_matrices(heads, head, width);
    let (values, value_steps) = build.int8_matrices(heads, width, head);
    let attend = Int8AttendOwn {
        rows,
        width: width as u16,
        heads: heads as u16,
        query: build.int8_layer(width, heads * head),
        keys,
        key_steps,
        values,
        value_steps,
        output: build.int8_layer(heads * head + skip, width),
        relu: (build.random.below(2) == 0).into(),
        query_place: build.place(heads * head),
        absorbed: build.place(2 * quantised_floats(width)),
        scores: build.place(n_max),
        attended: build.place(heads * head + skip),
        to: build.place(width),
        quantised: build.place(quantised_floats(width.max(heads * head + skip).max(n_max))),
    };
    let mut dense = |inputs: usize, outputs: usize, relu: bool, from: Place| Int8Dense {
        layer: build.int8_layer(inputs, outputs),
        relu: relu.into(),
        from,
        to: build.place(padded(outputs)),
        quantised: build.place(quantised_floats(inputs)),
    };
    let first = dense(width, base, true, attend.to);
    let last = dense(base, actions, false, first.to);
    let from = Place { len: actions as u32, ..last.to };
    let ops = [
        Op::Int8EmbedEntities(embed),
        Op::Int8AttendOwn(attend),
        Op::Int8Dense(first),
        Op::Int8Dense(last),
        Op::MaskedArgmax(MaskedArgmax { from }),
    ];
    let floats = build.floats as u32;
    (ProgramDraft { ops: ops.to_vec(), floats, nonzeros: 0 }, build.weights)
}

const SIZES: Sizes = Sizes {
    n_max: 5,
    features: 7,
    actions: 4,
    last_action: true,
    width: 24,
    heads: 2,
    head: 8,
    base: 8,
    skip: 0,
};

/// Why a plan with a changed program is refused.
fn refusal(change: impl Fn(&mut [Op])) -> Option<PlanError> {
    let (mut program, weights) = program(SIZES, &mut Random(9));
    change(&mut program.ops);
    Plan::load(assemble(SIZES, Profile::Int8, &program, &weights).as_slice()).err()
}

#[test]
fn places_and_sizes_that_do_not_fit_are_refused() {
    let refused = |op, got: Option<PlanError>| {
        assert_eq!(got, Some(PlanError::ShapeMismatch { op }));
    };
    assert_eq!(refusal(|_| ()), None);
    let embed = |change: fn(&mut Int8EmbedEntities)| {
        refusal(|ops| {
            ops.iter_mut().for_each(|op| {
                if let Op::Int8EmbedEntities(op) = op {
                    change(op)
                }
            })
        })
    };
    refused(0, embed(|op| op.quantised = Place { offset: 0, ..op.quantised }));
    refused(0, embed(|op| op.quantised.len -= 1));
    refused(0, embed(|op| op.layer.weights = 1 << 30));
    refused(0, embed(|op| op.layer.steps = u32::MAX));
    refused(0, embed(|op| op.last_actions = 3));
    refused(0, embed(|op| op.embedded.offset = op.quantised.offset));
    refused(0, embed(|op| op.embedded.len -= 8));
    let attend = |change: fn(&mut Int8AttendOwn)| {
        refusal(|ops| {
            ops.iter_mut().for_each(|op| {
                if let Op::Int8AttendOwn(op) = op {
                    change(op)
                }
            })
        })
    };
    refused(1, attend(|op| op.heads = 0));
    refused(1, attend(|op| op.heads = 4));
    refused(1, attend(|op| op.rows.len += 1));
    refused(1, attend(|op| op.quantised.offset = op.attended.offset));
    refused(1, attend(|op| op.absorbed.len -= 1));
    refused(1, attend(|op| op.to.offset = op.attended.offset));
    assert_eq!(attend(|op| op.to.offset = op.query_place.offset), None);
    refused(1, attend(|op| op.key_steps = 1 << 30));
    refused(1, attend(|op| op.values = 1 << 30));
    refused(1, attend(|op| op.output.inputs = 8));
    let dense = |change: fn(&mut Int8Dense)| {
        refusal(|ops| {
            ops.iter_mut().for_each(|op| {
                if let Op::Int8Dense(op) = op {
                    change(op)
                }
            })
        })
    };
    refused(2, dense(|op| op.quantised = op.to));
    refused(2, dense(|op| op.layer.bias = 1 << 30));
    refused(2, dense(|op| op.layer.outputs = 64));
}

#[test]
fn operators_of_the_other_layout_are_refused() {
    let (program, weights) = program(SIZES, &mut Random(9));
    let bytes = assemble(SIZES, Profile::Exact, &program, &weights);
    assert_eq!(Plan::load(bytes.as_slice()).err(), Some(PlanError::ShapeMismatch { op: 0 }));
    let bytes = assemble(SIZES, Profile::Int8, &program, &weights);
    let (mut header, _) = Header::read(bytes.as_slice()).unwrap();
    header.layout = LAYOUT_TILES;
    let program = &bytes.as_slice()[HEADER_BYTES..][..header.program_len as usize];
    let weights = &bytes.as_slice()[header.weights_offset as usize..];
    let mut other = AlignedBytes::copy_of(bytes.as_slice());
    let sums = checksums(&header, program, weights);
    other.as_mut_slice()[..HEADER_BYTES].copy_from_slice(&header.to_bytes(sums));
    assert_eq!(Plan::load(other.as_slice()).err(), Some(PlanError::WrongLayout { got: 1 }));
}

#[test]
fn numbers_that_are_none_are_refused_and_never_answered() {
    let mut random = Random(11);
    let bytes = plan(SIZES, &mut random);
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut frame = Frame::random(SIZES, 1, &mut random);
    frame.views[0].0 = crate::EntityMask::first(1);
    for bad in [f32::NAN, f32::INFINITY] {
        frame.rows[0] = bad;
        let got = alone(&plan, &frame.observations());
        assert_eq!(got, [Err(crate::DecideError::NonFinite)]);
    }
}
