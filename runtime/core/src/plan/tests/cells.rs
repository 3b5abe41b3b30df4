//! Recurrent cells, convolutions and layers on rows against plain arithmetic.

use std::vec;
use std::vec::Vec;

use super::Random;
use super::drafts::{Draft, assert_close, numbers, step};
use crate::DecideError;
use crate::kernels::product::{padded, tile_width};
use crate::ops::{
    Convolve, Dense, DenseRows, Flag, Function, GruCell, Input, Linear, LstmCell, Map, Meaning, Op,
    Place,
};
use crate::plan::PlanError;

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Sizes on both sides of the lanes that are worked on together.
const CELLS: [usize; 5] = [1, 5, 16, 23, 48];

#[test]
fn a_gru_cell_is_its_equations() {
    let mut random = Random(7);
    for size in CELLS {
        let [x, h] = [3 * size; 2].map(|count| numbers(&mut random, count));
        let state = numbers(&mut random, size);
        let got = step(&[&x, &h, &state], size, |from, to| {
            let (input, recurrent, state) = (from[0], from[1], from[2]);
            Op::GruCell(GruCell { input, recurrent, state, to })
        });
        let at = |all: &[f32], gate: usize, j: usize| f64::from(all[gate * size + j]);
        let want: Vec<f64> = (0..size)
            .map(|j| {
                let update = sigmoid(at(&x, 0, j) + at(&h, 0, j));
                let reset = sigmoid(at(&x, 1, j) + at(&h, 1, j));
                let candidate = (at(&x, 2, j) + reset * at(&h, 2, j)).tanh();
                (1.0 - update) * candidate + update * f64::from(state[j])
            })
            .collect();
        assert_close(&got, &want, "GRU");
    }
}

#[test]
fn an_lstm_cell_is_its_equations() {
    let mut random = Random(8);
    for size in CELLS {
        let [x, h, b] = [4 * size; 3].map(|count| numbers(&mut random, count));
        let cell = numbers(&mut random, size);
        let at = |gate: usize, j: usize| -> f64 {
            [&x, &h, &b].iter().map(|all| f64::from(all[gate * size + j])).sum()
        };
        let next =
            |j: usize| sigmoid(at(2, j)) * f64::from(cell[j]) + sigmoid(at(0, j)) * at(3, j).tanh();
        let cells: Vec<f64> = (0..size).map(next).collect();
        let states: Vec<f64> = (0..size).map(|j| sigmoid(at(1, j)) * cells[j].tanh()).collect();
        for (is_state, want) in [(true, states), (false, cells)] {
            let mut draft = Draft::default();
            let bias = draft.weights(&b);
            let [input, recurrent] = [&x, &h].map(|gates| draft.input(gates.len()));
            let before = draft.input(size);
            let (to, cell_to) = (draft.place(size), draft.place(size));
            let op = LstmCell { bias, input, recurrent, cell: before, to, cell_to };
            draft.push(Op::LstmCell(op));
            draft.output(if is_state { to } else { cell_to });
            let got = draft.respond(&[&x, &h, &cell], size).unwrap();
            assert_close(&got, &want, "LSTM");
        }
    }
}

#[test]
fn gates_do_not_hide_an_overflow() {
    let endless = [f32::MAX; 3];
    let mut draft = Draft::default();
    let (gates, state) = (draft.input(3), draft.input(1));
    let (twice, to) = (draft.place(3), draft.place(1));
    let (a, b) = (2.0_f32.to_bits(), 0);
    draft.push(Op::Map(Map { function: Function::Affine, a, b, from: gates, to: twice }));
    draft.push(Op::GruCell(GruCell { input: twice, recurrent: gates, state, to }));
    draft.output(to);
    assert_eq!(draft.respond(&[&endless, &[0.0]], 1), Err(DecideError::NonFinite));
}

#[test]
fn the_error_function_is_itself() {
    let points: Vec<f32> = (-40..=40).map(|x| x as f32 / 8.0).collect();
    let got = step(&[&points], points.len(), |from, to| {
        let (a, b) = (0, 0);
        Op::Map(Map { function: Function::Erf, a, b, from: from[0], to })
    });
    let want: Vec<f64> = points.iter().map(|x| libm::erf(f64::from(*x))).collect();
    assert_close(&got, &want, "erf");
}

/// Sizes of a convolution, each down and to the right.
struct Picture {
    channels: usize,
    outputs: usize,
    size: [usize; 2],
    kernel: [usize; 2],
    stride: [usize; 2],
    dilation: [usize; 2],
    padding: [usize; 2],
    result: [usize; 2],
}

const PLAIN: Picture = Picture {
    channels: 2,
    outputs: 3,
    size: [5, 6],
    kernel: [3, 2],
    stride: [1, 1],
    dilation: [1, 1],
    padding: [0, 0],
    result: [3, 5],
};

impl Picture {
    fn op(&self, layer: Linear, from: Place, rooms: [Place; 2], to: Place) -> Op {
        let small = |pair: [usize; 2]| pair.map(|number| number as u32);
        Op::Convolve(Convolve {
            layer,
            relu: Flag::No,
            channels: self.channels as u32,
            size: small(self.size),
            kernel: small(self.kernel),
            stride: small(self.stride),
            dilation: small(self.dilation),
            padding: small(self.padding),
            result: small(self.result),
            from,
            patch: rooms[0],
            point: rooms[1],
            to,
        })
    }

    fn inputs(&self) -> usize {
        self.channels * self.kernel[0] * self.kernel[1]
    }

    fn count(&self) -> usize {
        self.outputs * self.result[0] * self.result[1]
    }

    /// One number of the result, as the definition has it.
    fn point(&self, x: &[f32], weights: &[f32], at: [usize; 3]) -> f64 {
        let [output, row, column] = at;
        let mut sum = 0.0;
        for input in 0..self.inputs() {
            let area = self.kernel[0] * self.kernel[1];
            let (channel, k, l) =
                (input / area, input % area / self.kernel[1], input % self.kernel[1]);
            let place = |direction: usize, patch: usize, point: usize| {
                let place = patch * self.stride[direction] + point * self.dilation[direction];
                place.checked_sub(self.padding[direction]).filter(|y| *y < self.size[direction])
            };
            if let (Some(y), Some(z)) = (place(0, row, k), place(1, column, l)) {
                let number = x[(channel * self.size[0] + y) * self.size[1] + z];
                sum += f64::from(number) * f64::from(weights[input * self.outputs + output]);
            }
        }
        sum
    }
}

/// A matrix in tiles.
fn tiles(matrix: &[f32], outputs: usize) -> Vec<f32> {
    let (mut tiles, mut column) = (Vec::new(), 0);
    while column < outputs {
        let width = tile_width(padded(outputs) - column);
        for row in matrix.chunks(outputs) {
            tiles.extend((column..column + width).map(|at| row.get(at).copied().unwrap_or(0.0)));
        }
        column += width;
    }
    tiles
}

#[test]
fn convolutions_are_sums_over_patches() {
    let mut random = Random(9);
    for picture in [
        PLAIN,
        Picture { stride: [2, 3], result: [2, 2], ..PLAIN },
        Picture { padding: [1, 1], result: [5, 7], ..PLAIN },
        Picture { dilation: [2, 3], result: [1, 3], ..PLAIN },
        Picture { outputs: 70, kernel: [1, 1], result: [5, 6], ..PLAIN },
        Picture { size: [1, 9], kernel: [1, 3], padding: [0, 2], result: [1, 11], ..PLAIN },
    ] {
        let x = numbers(&mut random, picture.channels * picture.size[0] * picture.size[1]);
        let matrix = numbers(&mut random, picture.inputs() * picture.outputs);
        let mut draft = Draft::default();
        let (inputs, outputs) = (picture.inputs() as u16, picture.outputs as u16);
        let weights = draft.weights(&tiles(&matrix, picture.outputs));
        let bias = draft.weights(&vec![0.5; padded(picture.outputs)]);
        let layer = Linear { inputs, outputs, weights, bias };
        let from = draft.input(x.len());
        let rooms = [draft.place(picture.inputs()), draft.place(padded(picture.outputs))];
        let to = draft.place(picture.count());
        draft.push(picture.op(layer, from, rooms, to));
        draft.output(to);
        let got = draft.respond(&[&x], picture.count()).unwrap();
        let [height, width] = picture.result;
        let want: Vec<f64> = (0..picture.count())
            .map(|at| [at / (height * width), at / width % height, at % width])
            .map(|at| 0.5 + picture.point(&x, &matrix, at))
            .collect();
        assert_close(&got, &want, "convolution");
    }
}

#[test]
fn cells_and_convolutions_stay_inside_their_places() {
    let place = |offset, len| Place { offset, len };
    let gru = |input, recurrent, state, to| Op::GruCell(GruCell { input, recurrent, state, to });
    let lstm = |bias, cell, to, cell_to| {
        let (input, recurrent) = (place(0, 16), place(0, 16));
        Op::LstmCell(LstmCell { bias, input, recurrent, cell, to, cell_to })
    };
    let convolve = |picture: Picture, layer, to| {
        picture.op(layer, place(0, 60), [place(64, 12), place(80, 8)], to)
    };
    let layer = Linear { inputs: 12, outputs: 3, weights: 0, bias: 96 };
    let to = place(96, 45);
    let wrong = [
        gru(place(0, 12), place(0, 12), place(0, 4), place(8, 4)),
        gru(place(0, 12), place(0, 11), place(0, 4), place(16, 4)),
        gru(place(0, 12), place(0, 12), place(0, 5), place(16, 5)),
        gru(place(0, 0), place(0, 0), place(0, 0), place(16, 0)),
        gru(place(0, 12), place(0, 12), place(0, 4), place(198, 4)),
        lstm(0, place(0, 4), place(96, 4), place(98, 4)),
        lstm(0, place(0, 4), place(96, 4), place(12, 4)),
        lstm(0, place(0, 4), place(96, 4), place(100, 3)),
        lstm(100, place(0, 4), place(96, 4), place(100, 4)),
        lstm(u32::MAX, place(0, 4), place(96, 4), place(100, 4)),
        convolve(Picture { stride: [0, 1], ..PLAIN }, layer, to),
        convolve(Picture { dilation: [1, 0], ..PLAIN }, layer, to),
        convolve(Picture { channels: 3, ..PLAIN }, layer, to),
        convolve(Picture { size: [5, 7], ..PLAIN }, layer, to),
        convolve(Picture { kernel: [3, 3], ..PLAIN }, layer, to),
        convolve(Picture { result: [4, 5], ..PLAIN }, layer, to),
        convolve(PLAIN, layer, place(48, 45)),
        convolve(PLAIN, layer, place(87, 45)),
        convolve(PLAIN, Linear { outputs: 4, ..layer }, to),
        convolve(PLAIN, Linear { bias: 105, ..layer }, to),
        convolve(Picture { channels: 0, result: [0, 0], ..PLAIN }, layer, place(96, 0)),
    ];
    for op in wrong {
        let mut draft = Draft { weights: vec![0.0; 112], ..Draft::default() };
        draft.program.floats = 200;
        let (index, meaning) = (0, Meaning::None);
        draft.push(Op::Input(Input { index, meaning, to: place(0, 64) }));
        draft.push(op);
        draft.output(place(0, 8));
        assert_eq!(draft.refused(), Some(PlanError::ShapeMismatch { op: 1 }), "{op:?}");
    }
}

#[test]
fn every_row_gets_what_it_would_get_alone() {
    let mut random = Random(10);
    for (rows, inputs, outputs) in [(2, 5, 3), (7, 6, 8), (8, 9, 64), (19, 4, 72), (3, 1, 10)] {
        let x = numbers(&mut random, rows * inputs);
        let matrix = numbers(&mut random, inputs * outputs);
        let mut draft = Draft::default();
        let weights = draft.weights(&tiles(&matrix, outputs));
        let bias = draft.weights(&vec![-0.25; padded(outputs)]);
        let layer = Linear { inputs: inputs as u16, outputs: outputs as u16, weights, bias };
        let mut alone = Draft { weights: draft.weights.clone(), ..Draft::default() };
        let from = draft.input(x.len());
        let to = draft.place((rows - 1) * outputs + padded(outputs));
        let relu = Flag::Yes;
        draft.push(Op::DenseRows(DenseRows { layer, relu, rows: rows as u32, from, to }));
        draft.output(Place { len: (rows * outputs) as u32, ..to });
        let together = draft.respond(&[&x], rows * outputs).unwrap();
        let (row, to) = (alone.input(inputs), alone.place(padded(outputs)));
        let sparse_input = Flag::No;
        alone.push(Op::Dense(Dense { layer, relu, sparse_input, from: row, to }));
        alone.output(Place { len: outputs as u32, ..to });
        for (x, together) in x.chunks(inputs).zip(together.chunks(outputs)) {
            let alone = alone.respond(&[x], outputs).unwrap();
            let bits = |numbers: &[f32]| numbers.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(together), bits(&alone), "{rows} rows of {inputs} to {outputs}");
        }
    }
}

#[test]
fn layers_on_rows_stay_inside_their_places() {
    let place = |offset, len| Place { offset, len };
    let layer = Linear { inputs: 4, outputs: 3, weights: 0, bias: 32 };
    let on = |rows, from, to| Op::DenseRows(DenseRows { layer, relu: Flag::No, rows, from, to });
    let wrong = [
        on(0, place(0, 0), place(64, 8)),
        on(2, place(0, 7), place(64, 11)),
        on(2, place(0, 8), place(64, 10)),
        on(2, place(0, 8), place(4, 11)),
        on(2, place(0, 8), place(190, 11)),
        on(u32::MAX, place(0, 8), place(64, 11)),
    ];
    for op in wrong {
        let mut draft = Draft { weights: vec![0.0; 64], ..Draft::default() };
        draft.program.floats = 200;
        let (index, meaning) = (0, Meaning::None);
        draft.push(Op::Input(Input { index, meaning, to: place(0, 64) }));
        draft.push(op);
        draft.output(place(0, 8));
        assert_eq!(draft.refused(), Some(PlanError::ShapeMismatch { op: 1 }), "{op:?}");
    }
}
