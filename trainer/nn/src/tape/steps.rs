//! The steps of a pass: each computes a matrix from others and writes down how. Those with parameters are [`layers`](super::layers).

use std::ops::Range;

use super::{Indices, Operation, Pass, Tape, Var};
use crate::layers::elementwise::Activation;
use crate::layers::matrix::Store;
use crate::layers::{elementwise, softmax};

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
        self.tape.split([], y).1.copy_from_slice(numbers);
        y
    }

    /// The same numbers, which the loss no longer depends on through this.
    pub fn detach(&mut self, x: Var) -> Var {
        let [rows, columns] = self.size(x);
        let y = self.tape.push(Operation::Given, rows, columns, false);
        let ([x], out) = self.tape.split([x], y);
        out.copy_from_slice(x);
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
        self.tape.node(Operation::Given, size, node.at + offset, Some(node.base), node.needs_slopes)
    }

    /// A step from one matrix.
    pub(super) fn step(
        &mut self,
        operation: Operation,
        x: Var,
        size: [usize; 2],
        compute: impl FnOnce(&[f32], &mut [f32]),
    ) -> Var {
        self.keep(0, |_| operation, [x], size, |[x], _, y| compute(x, y))
    }

    /// A step from two matrices.
    pub(super) fn join(
        &mut self,
        operation: Operation,
        inputs: [Var; 2],
        size: [usize; 2],
        compute: impl FnOnce(&[f32], &[f32], &mut [f32]),
    ) -> Var {
        self.keep(0, |_| operation, inputs, size, |[a, b], _, y| compute(a, b, y))
    }

    /// A step that keeps so many numbers for its way back, besides its result; the operation is told where they begin.
    pub(super) fn keep<const N: usize>(
        &mut self,
        numbers: usize,
        operation: impl FnOnce(usize) -> Operation,
        inputs: [Var; N],
        [rows, columns]: [usize; 2],
        compute: impl FnOnce([&[f32]; N], &mut [f32], &mut [f32]),
    ) -> Var {
        let needs = inputs.iter().any(|x| self.tape.of(*x).needs_slopes);
        let start = self.tape.reserve(numbers);
        let y = self.tape.push(operation(start), rows, columns, needs);
        let (ranges, out) = (inputs.map(|x| self.tape.of(x).range()), self.tape.of(y).range());
        let (before, rest) = self.tape.values.split_at_mut(start);
        let (kept, rest) = rest.split_at_mut(numbers);
        compute(ranges.map(|range| &before[range]), kept, &mut rest[..out.len()]);
        y
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

    pub(super) fn activate(&mut self, x: Var, activation: Activation) -> Var {
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

    /// `factor x`
    pub fn scale(&mut self, x: Var, factor: f32) -> Var {
        let size = self.size(x);
        self.step(Operation::Scale { x, factor }, x, size, |x, y| {
            elementwise::scale(factor, x, Store::Replace, y);
        })
    }

    /// `a + b`; a `b` of fewer rows is added to every block of as many.
    pub fn add(&mut self, a: Var, b: Var) -> Var {
        let (size, repeated) = (self.size(a), self.size(b));
        assert!(size[1] == repeated[1] && size[0].is_multiple_of(repeated[0]), "sizes");
        self.join(Operation::Add { a, b }, [a, b], size, |a, b, y| {
            let block = b.len().max(1);
            for (a, y) in a.chunks_exact(block).zip(y.chunks_exact_mut(block)) {
                elementwise::add(a, b, y);
            }
        })
    }

    /// `a b`, number by number.
    pub fn multiply(&mut self, a: Var, b: Var) -> Var {
        let size = self.size(a);
        assert_eq!(size, self.size(b), "sizes");
        self.join(Operation::Multiply { a, b }, [a, b], size, |a, b, y| {
            elementwise::multiply(a, b, Store::Replace, y);
        })
    }

    /// Every row of `x` times its number in `by [rows, 1]`.
    pub fn scale_rows(&mut self, x: Var, by: Var) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(self.size(by), [rows, 1], "a factor for every row");
        self.join(Operation::ScaleRows { x, by }, [x, by], [rows, columns], |x, by, y| {
            for ((y, x), by) in y.chunks_exact_mut(columns).zip(x.chunks_exact(columns)).zip(by) {
                elementwise::scale(*by, x, Store::Replace, y);
            }
        })
    }

    /// Dueling heads (Wang et al. 2016): `value [rows, 1] + advantages - their mean`.
    pub fn dueling(&mut self, value: Var, advantages: Var) -> Var {
        let [rows, columns] = self.size(advantages);
        assert_eq!(self.size(value), [rows, 1], "a value for every row");
        let operation = Operation::Dueling { value, advantages };
        self.join(operation, [value, advantages], [rows, columns], |value, advantages, y| {
            let advantages = advantages.chunks_exact(columns);
            for ((y, advantages), value) in y.chunks_exact_mut(columns).zip(advantages).zip(value) {
                let level = value - advantages.iter().sum::<f32>() / columns as f32;
                y.iter_mut().zip(advantages).for_each(|(y, advantage)| *y = level + advantage);
            }
        })
    }

    /// `factor` times the sum of all squares `(x - target)^2`.
    pub fn squared_error(&mut self, x: Var, target: &[f32], factor: f32) -> Var {
        let target = self.input(1, target);
        let operation = Operation::SquaredError { x, target, factor };
        self.loss(operation, x, target, |x, target| elementwise::squared_error(x, target, factor))
    }

    /// `factor` times the sum of Huber's losses: half a square up to a distance of `bound`, a line from there.
    pub fn huber(&mut self, x: Var, target: &[f32], factor: f32, bound: f32) -> Var {
        let target = self.input(1, target);
        let operation = Operation::Huber { x, target, factor, bound };
        self.loss(operation, x, target, |x, target| elementwise::huber(x, target, factor, bound))
    }

    fn loss(
        &mut self,
        operation: Operation,
        x: Var,
        target: Var,
        loss: impl FnOnce(&[f32], &[f32]) -> f32,
    ) -> Var {
        self.join(operation, [x, target], [1, 1], |x, target, y| {
            assert_eq!(x.len(), target.len(), "a target for every number");
            y[0] = loss(x, target);
        })
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

    /// The sum of all rows.
    pub fn sum_rows(&mut self, x: Var) -> Var {
        let [rows, columns] = self.size(x);
        let indices = self.tape.store_indices(std::iter::repeat_n(0, rows));
        self.step(Operation::Scatter { x, indices }, x, [1, columns], |x, y| {
            y.fill(0.0);
            x.chunks_exact(columns).for_each(|x| elementwise::scale(1.0, x, Store::Add, y));
        })
    }

    /// The mean of all rows.
    pub fn mean_rows(&mut self, x: Var) -> Var {
        let sum = self.sum_rows(x);
        self.scale(sum, 1.0 / self.size(x)[0] as f32)
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
        let operation = Operation::Columns { x, first: columns.start };
        self.step(operation, x, [rows, columns.len()], |x, y| {
            for (y, x) in y.chunks_exact_mut(columns.len()).zip(x.chunks_exact(width)) {
                y.copy_from_slice(&x[columns.clone()]);
            }
        })
    }

    /// The columns of several matrices beside each other.
    pub fn concat(&mut self, parts: &[Var]) -> Var {
        if let [whole] = parts {
            return *whole;
        }
        let parts = self.tape.store_indices(parts.iter().map(|part| part.0));
        self.join_columns(parts)
    }

    /// The rows of several matrices behind each other.
    pub fn stack(&mut self, parts: &[Var]) -> Var {
        if let [whole] = parts {
            return *whole;
        }
        let columns = parts.first().map_or(1, |part| self.size(*part)[1]);
        let first = self.tape.indices.len();
        for part in parts {
            let [rows, width] = self.size(*part);
            assert_eq!(width, columns, "columns of every part");
            let row = self.reshape(*part, rows * width);
            self.tape.indices.push(row.0);
        }
        let row = self.join_columns((first, first + parts.len()));
        self.reshape(row, columns)
    }

    /// The columns of the matrices whose numbers stand among the tape's indices.
    fn join_columns(&mut self, parts: Indices) -> Var {
        let numbers = parts.0..parts.1;
        let part = |tape: &Tape, number: usize| Var(tape.indices[number]);
        let sizes = numbers.clone().map(|number| self.size(part(self.tape, number)));
        let (rows, width) = sizes.fold((0, 0), |sum, [rows, columns]| (rows, sum.1 + columns));
        let needs = |number| self.tape.of(part(self.tape, number)).needs_slopes;
        let needs = numbers.clone().any(needs);
        let y = self.tape.push(Operation::Concat { parts }, rows, width, needs);
        let mut first = 0;
        for number in numbers {
            let part = part(self.tape, number);
            let [count, columns] = self.size(part);
            assert_eq!(count, rows, "rows of every part");
            let ([x], out) = self.tape.split([part], y);
            for (y, x) in out.chunks_exact_mut(width).zip(x.chunks_exact(columns)) {
                y[first..first + columns].copy_from_slice(x);
            }
            first += columns;
        }
        y
    }
}
