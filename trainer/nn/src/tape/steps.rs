//! The steps of a pass: each computes a matrix from others and writes down how.

use std::ops::Range;

use super::operation::Operation;
use super::{Gru, Linear, Norm, Pass, Var};
use crate::layers::attention::{self, AttentionShape};
use crate::layers::elementwise::{self, Activation};
use crate::layers::gru::GruShape;
use crate::layers::matrix::Store;
use crate::layers::unfold::{self, UnfoldShape};
use crate::layers::{SparseRows, VisibleLists, linear, losses, normalise, softmax, sparse_linear};

impl Pass<'_> {
    /// Rows from outside, which are no part of what is learned.
    pub fn input(&mut self, columns: usize, numbers: &[f32]) -> Var {
        self.given(columns, numbers, false)
    }

    /// Rows from outside whose slopes are wanted: see [`slopes`](Self::slopes).
    pub fn leaf(&mut self, columns: usize, numbers: &[f32]) -> Var {
        self.given(columns, numbers, true)
    }

    fn given(&mut self, columns: usize, numbers: &[f32], needs_slopes: bool) -> Var {
        let rows = numbers.len() / columns;
        assert_eq!(rows * columns, numbers.len(), "whole rows");
        let y = self.tape.push(Operation::Given, rows, columns, needs_slopes);
        self.tape.split(y).1.copy_from_slice(numbers);
        y
    }

    /// The same numbers, which the loss no longer depends on through this.
    pub fn detach(&mut self, x: Var) -> Var {
        let [rows, columns] = self.size(x);
        let y = self.tape.push(Operation::Given, rows, columns, false);
        let range = self.tape.of(x).range();
        let (before, out) = self.tape.split(y);
        out.copy_from_slice(&before[range]);
        y
    }

    /// The same numbers in rows of another length.
    pub fn reshape(&mut self, x: Var, columns: usize) -> Var {
        let [rows, old] = self.size(x);
        assert_eq!(rows * old % columns, 0, "whole rows");
        self.share(x, 0, [rows * old / columns, columns])
    }

    /// Some rows behind each other.
    pub fn rows(&mut self, x: Var, rows: Range<usize>) -> Var {
        let columns = self.size(x)[1];
        assert!(rows.end <= self.size(x)[0], "rows that are there");
        self.share(x, rows.start * columns, [rows.len(), columns])
    }

    fn share(&mut self, x: Var, offset: usize, size: [usize; 2]) -> Var {
        let node = self.tape.of(x);
        let at = node.at as usize + offset;
        self.tape.node(Operation::Given, size, at, Some(node.base), node.needs_slopes)
    }

    /// `x W' + b`
    pub fn linear(&mut self, x: Var, layer: Linear) -> Var {
        self.affine(x, layer, false)
    }

    /// `max(0, x W' + b)`
    pub fn linear_rectified(&mut self, x: Var, layer: Linear) -> Var {
        self.affine(x, layer, true)
    }

    fn affine(&mut self, x: Var, layer: Linear, rectified: bool) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(columns, layer.shape.input, "columns of the input");
        let operation = Operation::Linear { x, layer, rectified };
        let y = self.tape.push(operation, rows, layer.shape.output, true);
        let weight = &self.parameters[layer.weight_range()];
        let bias = layer.bias_range().map(|range| &self.parameters[range]);
        let range = self.tape.of(x).range();
        let (before, out) = self.tape.split(y);
        let x = &before[range];
        match (bias, rectified) {
            (Some(bias), false) => linear::forward(layer.shape, x, weight, bias, out),
            (Some(bias), true) => linear::forward_rectified(layer.shape, x, weight, bias, out),
            (None, false) => linear::forward_without_bias(layer.shape, x, weight, out),
            (None, true) => {
                linear::forward_without_bias(layer.shape, x, weight, out);
                crate::layers::relu::forward(out);
            }
        }
        y
    }

    /// A first layer over features that are mostly zeros; its weight is `[input, output]`.
    pub fn sparse_linear(&mut self, features: &SparseRows, layer: Linear) -> Var {
        let (rows, kept) = self.tape.sparse.next();
        kept.clear();
        kept.append(features);
        let operation = Operation::SparseLinear { rows, layer };
        let y = self.tape.push(operation, features.len(), layer.shape.output, true);
        let weight = &self.parameters[layer.weight_range()];
        let bias = layer.bias_range().expect("sparse layers have offsets");
        sparse_linear::forward(features, weight, &self.parameters[bias], self.tape.split(y).1);
        y
    }

    /// A convolution: a picture a row in, its patches behind each other out, `[patches, output]` of each.
    pub fn convolution(&mut self, x: Var, shape: UnfoldShape, layer: Linear) -> Var {
        let pictures = self.size(x)[0];
        let patches = self.unfold(x, shape);
        let y = self.linear(patches, layer);
        let numbers = self.size(y)[0] * layer.shape.output;
        self.reshape(y, numbers / pictures)
    }

    /// The patches of pictures, each a row.
    pub fn unfold(&mut self, x: Var, shape: UnfoldShape) -> Var {
        let [pictures, columns] = self.size(x);
        assert_eq!(columns, shape.picture(), "columns of a picture");
        let (down, across) = shape.patches();
        let rows = pictures * down * across;
        self.step(Operation::Unfold { x, shape }, x, [rows, shape.patch()], |x, y| {
            unfold::forward(shape, x, y);
        })
    }

    /// `max(0, x)`
    pub fn relu(&mut self, x: Var) -> Var {
        self.activate(x, Activation::Relu)
    }

    /// `x` where it is positive, else so many times `x`.
    pub fn leaky_relu(&mut self, x: Var, slope: f32) -> Var {
        self.activate(x, Activation::LeakyRelu(slope))
    }

    /// The hyperbolic tangent.
    pub fn tanh(&mut self, x: Var) -> Var {
        self.activate(x, Activation::Tanh)
    }

    /// `1 / (1 + exp(-x))`
    pub fn sigmoid(&mut self, x: Var) -> Var {
        self.activate(x, Activation::Sigmoid)
    }

    fn activate(&mut self, x: Var, activation: Activation) -> Var {
        let size = self.size(x);
        self.step(Operation::Activate { x, activation }, x, size, |x, y| {
            elementwise::activate(activation, x, y);
        })
    }

    /// The softmax of every row.
    pub fn softmax(&mut self, x: Var) -> Var {
        let size = self.size(x);
        self.step(Operation::Softmax { x }, x, size, |x, y| {
            y.copy_from_slice(x);
            y.chunks_exact_mut(size[1]).for_each(softmax::forward);
        })
    }

    /// The logarithm of the softmax of every row.
    pub fn log_softmax(&mut self, x: Var) -> Var {
        let size = self.size(x);
        self.step(Operation::LogSoftmax { x }, x, size, |x, y| {
            y.copy_from_slice(x);
            y.chunks_exact_mut(size[1]).for_each(softmax::log_forward);
        })
    }

    /// Layer normalisation: every row with mean 0 and variance 1, then factors and offsets of columns.
    pub fn layer_norm(&mut self, x: Var, layer: Norm) -> Var {
        let size = self.size(x);
        let normal = self.step(Operation::Normalise { x }, x, size, |x, y| {
            normalise::rows(size[1], x, y);
        });
        let y = self.tape.push(Operation::Affine { x: normal, layer }, size[0], size[1], true);
        let parameters = &self.parameters[layer.start..layer.start + 2 * layer.width];
        let (factors, offsets) = parameters.split_at(layer.width);
        let range = self.tape.of(normal).range();
        let (before, out) = self.tape.split(y);
        normalise::affine(factors, offsets, &before[range], out);
        y
    }

    /// What each query makes of the rows that it sees: `queries [queries, width]`, `keys_values [rows, 2 width]`
    /// a key and its value in a row. Several passes may share keys and values, and see others of them.
    pub fn attention(
        &mut self,
        queries: Var,
        keys_values: Var,
        visible: &VisibleLists,
        heads: usize,
    ) -> Var {
        let [count, width] = self.size(queries);
        assert_eq!((count, 2 * width), (visible.queries(), self.size(keys_values)[1]), "sizes");
        let shape = AttentionShape { width, heads };
        let (lists, kept) = self.tape.lists.next();
        kept.copy_from(visible);
        let pairs = visible.pairs() * heads;
        let weights = self.tape.reserve(pairs);
        let operation =
            Operation::Attend { queries, keys_values, lists, weights: weights as u32, shape };
        let needs = self.tape.needs(queries) || self.tape.needs(keys_values);
        let y = self.tape.push(operation, count, width, needs);
        let ranges = [queries, keys_values].map(|var| self.tape.of(var).range());
        // The weights stand between the inputs and the result.
        let range = self.tape.of(y).range();
        let (before, rest) = self.tape.values.split_at_mut(weights);
        let (weights, rest) = rest.split_at_mut(range.start - weights);
        let [queries, keys_values] = ranges.map(|range| &before[range]);
        let out = &mut rest[..count * width];
        attention::forward(shape, visible, queries, keys_values, &mut weights[..pairs], out);
        y
    }

    /// The memories of a recurrent unit after each step of `x [steps * slots, width]`, from `memory
    /// [slots, width]`, which gets no slopes and becomes what is left; it is emptied behind each step where
    /// `carry [steps * slots]` does not hold.
    pub fn gru(&mut self, x: Var, layer: Gru, carry: &[bool], memory: &mut [f32]) -> Var {
        let [rows, width] = self.size(x);
        assert_eq!((rows, width), (carry.len(), layer.width), "sizes");
        let slots = memory.len() / width;
        let first = self.tape.carry.len();
        self.tape.carry.extend_from_slice(carry);
        let (pass, _) = self.tape.grus.next();
        let operation =
            Operation::Recur { x, pass, carry: first as u32, slots: slots as u32, layer };
        let y = self.tape.push(operation, rows, width, true);
        let (range, out) = (self.tape.of(x).range(), self.tape.of(y).range());
        let (before, rest) = self.tape.values.split_at_mut(out.start);
        self.tape.grus.things[pass as usize].forward(
            GruShape { width, slots },
            &self.parameters[layer.range()],
            (&before[range], carry),
            memory,
            &mut rest[..out.len()],
        );
        y
    }

    /// Rows by their numbers, some perhaps several times.
    pub fn gather(&mut self, x: Var, rows: &[u32]) -> Var {
        let columns = self.size(x)[1];
        let indices = self.tape.store_indices(rows.iter().copied());
        self.step(Operation::Gather { x, indices }, x, [rows.len(), columns], |x, y| {
            for (row, y) in rows.iter().zip(y.chunks_exact_mut(columns)) {
                y.copy_from_slice(&x[*row as usize * columns..][..columns]);
            }
        })
    }

    /// So many rows, of which row `to[i]` is the sum of all rows i of `x`: sums over groups of any size.
    pub fn scatter(&mut self, x: Var, to: &[u32], rows: usize) -> Var {
        let [count, columns] = self.size(x);
        assert_eq!(count, to.len(), "a place for every row");
        let indices = self.tape.store_indices(to.iter().copied());
        self.step(Operation::Scatter { x, indices }, x, [rows, columns], |x, y| {
            y.fill(0.0);
            for (row, x) in to.iter().zip(x.chunks_exact(columns)) {
                let y = &mut y[*row as usize * columns..][..columns];
                elementwise::scale(1.0, x, Store::Add, y);
            }
        })
    }

    /// The sum of every so many rows.
    pub fn sum_groups(&mut self, x: Var, size: usize) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(rows % size, 0, "whole groups");
        let indices = self.tape.store_indices((0..rows).map(|row| (row / size) as u32));
        self.step(Operation::Scatter { x, indices }, x, [rows / size, columns], |x, y| {
            y.fill(0.0);
            for (y, x) in y.chunks_exact_mut(columns).zip(x.chunks_exact(size * columns)) {
                x.chunks_exact(columns).for_each(|x| elementwise::scale(1.0, x, Store::Add, y));
            }
        })
    }

    /// The mean of every so many rows.
    pub fn mean_groups(&mut self, x: Var, size: usize) -> Var {
        let sum = self.sum_groups(x, size);
        self.scale(sum, 1.0 / size as f32)
    }

    /// The sum of all rows.
    pub fn sum_rows(&mut self, x: Var) -> Var {
        let rows = self.size(x)[0];
        self.sum_groups(x, rows)
    }

    /// The mean of all rows.
    pub fn mean_rows(&mut self, x: Var) -> Var {
        let rows = self.size(x)[0];
        self.mean_groups(x, rows)
    }

    /// The sum of every row.
    pub fn sum_columns(&mut self, x: Var) -> Var {
        let [rows, columns] = self.size(x);
        self.step(Operation::SumColumns { x }, x, [rows, 1], |x, y| {
            for (y, x) in y.iter_mut().zip(x.chunks_exact(columns)) {
                *y = x.iter().sum();
            }
        })
    }

    /// The mean of every row.
    pub fn mean_columns(&mut self, x: Var) -> Var {
        let columns = self.size(x)[1];
        let sum = self.sum_columns(x);
        self.scale(sum, 1.0 / columns as f32)
    }

    /// The number of one column of every row, such as the utility of the action that was chosen.
    pub fn pick(&mut self, x: Var, columns: &[u32]) -> Var {
        let [rows, width] = self.size(x);
        assert_eq!(rows, columns.len(), "a column for every row");
        let indices = self.tape.store_indices(columns.iter().copied());
        self.step(Operation::Pick { x, indices }, x, [rows, 1], |x, y| {
            for ((y, x), column) in y.iter_mut().zip(x.chunks_exact(width)).zip(columns) {
                *y = x[*column as usize];
            }
        })
    }

    /// Some columns behind each other.
    pub fn columns(&mut self, x: Var, columns: Range<usize>) -> Var {
        let [rows, width] = self.size(x);
        let operation = Operation::Columns { x, first: columns.start as u32 };
        self.step(operation, x, [rows, columns.len()], |x, y| {
            for (y, x) in y.chunks_exact_mut(columns.len()).zip(x.chunks_exact(width)) {
                y.copy_from_slice(&x[columns.clone()]);
            }
        })
    }

    /// The columns of several matrices beside each other.
    pub fn concat(&mut self, parts: &[Var]) -> Var {
        let rows = parts.first().map_or(0, |part| self.size(*part)[0]);
        let width: usize = parts.iter().map(|part| self.size(*part)[1]).sum();
        let needs = parts.iter().any(|part| self.tape.needs(*part));
        let indices = self.tape.store_indices(parts.iter().map(|part| part.0));
        let y = self.tape.push(Operation::Concat { parts: indices }, rows, width, needs);
        let mut first = 0;
        for part in parts {
            let (range, [count, columns]) = (self.tape.of(*part).range(), self.size(*part));
            assert_eq!(count, rows, "rows of every part");
            let (before, out) = self.tape.split(y);
            for (y, x) in out.chunks_exact_mut(width).zip(before[range].chunks_exact(columns)) {
                y[first..first + columns].copy_from_slice(x);
            }
            first += columns;
        }
        y
    }

    /// `factor x`
    pub fn scale(&mut self, x: Var, factor: f32) -> Var {
        let size = self.size(x);
        self.step(Operation::Scale { x, factor }, x, size, |x, y| {
            elementwise::scale(factor, x, Store::Replace, y);
        })
    }

    /// `a + b`
    pub fn add(&mut self, a: Var, b: Var) -> Var {
        self.join(Operation::Add { a, b }, a, b, elementwise::add)
    }

    /// `a b`, number by number.
    pub fn multiply(&mut self, a: Var, b: Var) -> Var {
        self.join(Operation::Multiply { a, b }, a, b, |a, b, y| {
            elementwise::multiply(a, b, Store::Replace, y);
        })
    }

    /// Every row of `x` times its number in `by [rows, 1]`.
    pub fn scale_rows(&mut self, x: Var, by: Var) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(self.size(by), [rows, 1], "a factor for every row");
        let needs = self.tape.needs(x) || self.tape.needs(by);
        let y = self.tape.push(Operation::ScaleRows { x, by }, rows, columns, needs);
        let ranges = [x, by].map(|var| self.tape.of(var).range());
        let (before, out) = self.tape.split(y);
        let [x, by] = ranges.map(|range| &before[range]);
        for ((y, x), by) in out.chunks_exact_mut(columns).zip(x.chunks_exact(columns)).zip(by) {
            elementwise::scale(*by, x, Store::Replace, y);
        }
        y
    }

    /// Dueling heads (Wang et al. 2016): `value [rows, 1] + advantages - their mean`.
    pub fn dueling(&mut self, value: Var, advantages: Var) -> Var {
        let [rows, columns] = self.size(advantages);
        assert_eq!(self.size(value), [rows, 1], "a value for every row");
        let needs = self.tape.needs(value) || self.tape.needs(advantages);
        let y = self.tape.push(Operation::Dueling { value, advantages }, rows, columns, needs);
        let ranges = [value, advantages].map(|var| self.tape.of(var).range());
        let (before, out) = self.tape.split(y);
        let [value, advantages] = ranges.map(|range| &before[range]);
        let advantages = advantages.chunks_exact(columns);
        for ((y, advantages), value) in out.chunks_exact_mut(columns).zip(advantages).zip(value) {
            let level = value - advantages.iter().sum::<f32>() / columns as f32;
            y.iter_mut().zip(advantages).for_each(|(y, advantage)| *y = level + advantage);
        }
        y
    }

    /// `factor` times the sum of all squares `(x - target)^2`.
    pub fn squared_error(&mut self, x: Var, target: &[f32], factor: f32) -> Var {
        let target = self.input(1, target);
        let operation = Operation::SquaredError { x, target, factor };
        self.loss(operation, x, target, |x, target| losses::squared_error(x, target, factor))
    }

    /// `factor` times the sum of Huber's losses: half a square up to a distance of `bound`, a line from there.
    pub fn huber(&mut self, x: Var, target: &[f32], factor: f32, bound: f32) -> Var {
        let target = self.input(1, target);
        let operation = Operation::Huber { x, target, factor, bound };
        self.loss(operation, x, target, |x, target| losses::huber(x, target, factor, bound))
    }

    fn loss(
        &mut self,
        operation: Operation,
        x: Var,
        target: Var,
        loss: impl FnOnce(&[f32], &[f32]) -> f32,
    ) -> Var {
        let ranges = [x, target].map(|var| self.tape.of(var).range());
        assert_eq!(ranges[0].len(), ranges[1].len(), "a target for every number");
        let needs = self.tape.needs(x);
        let y = self.tape.push(operation, 1, 1, needs);
        let (before, out) = self.tape.split(y);
        let [x, target] = ranges.map(|range| &before[range]);
        out[0] = loss(x, target);
        y
    }

    /// A pass that is written by hand, added with [`Tape::add_custom`](super::Tape::add_custom).
    pub fn custom(&mut self, number: usize, x: Var, [rows, columns]: [usize; 2]) -> Var {
        let operation = Operation::Custom { x, number: number as u32 };
        let y = self.tape.push(operation, rows, columns, true);
        let (range, out) = (self.tape.of(x).range(), self.tape.of(y).range());
        let (before, rest) = self.tape.values.split_at_mut(out.start);
        let out = &mut rest[..out.len()];
        self.tape.customs[number].forward(self.parameters, &before[range], out);
        y
    }

    /// A step from one matrix.
    fn step(
        &mut self,
        operation: Operation,
        x: Var,
        [rows, columns]: [usize; 2],
        compute: impl FnOnce(&[f32], &mut [f32]),
    ) -> Var {
        let needs = self.tape.needs(x);
        let y = self.tape.push(operation, rows, columns, needs);
        let range = self.tape.of(x).range();
        let (before, out) = self.tape.split(y);
        compute(&before[range], out);
        y
    }

    /// A step from two matrices of the same size.
    fn join(
        &mut self,
        operation: Operation,
        a: Var,
        b: Var,
        compute: impl FnOnce(&[f32], &[f32], &mut [f32]),
    ) -> Var {
        let size = self.size(a);
        assert_eq!(size, self.size(b), "sizes");
        let needs = self.tape.needs(a) || self.tape.needs(b);
        let y = self.tape.push(operation, size[0], size[1], needs);
        let ranges = [a, b].map(|var| self.tape.of(var).range());
        let (before, out) = self.tape.split(y);
        let [a, b] = ranges.map(|range| &before[range]);
        compute(a, b, out);
        y
    }
}
