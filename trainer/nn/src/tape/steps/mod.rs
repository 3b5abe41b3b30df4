//! The steps of a pass: each computes a matrix from others and writes down how.

mod arithmetic;
mod layers;
mod losses;
mod rows;

use std::ops::Range;

use super::operation::Operation;
use super::{Pass, Var};

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
