//! Steps number by number, and within a row.

use super::super::operation::Operation;
use super::super::{Pass, Var};
use crate::layers::elementwise::{self, Activation};
use crate::layers::matrix::Store;
use crate::layers::softmax;

impl Pass<'_> {
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
}
