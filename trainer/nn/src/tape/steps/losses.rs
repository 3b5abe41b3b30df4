//! Steps to one number, which learning makes small.

use super::super::operation::Operation;
use super::super::{Pass, Var};
use crate::layers::losses;

impl Pass<'_> {
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
}
