//! Functions of numbers: of one value, of two, of a condition.

use sortie_core::ops::{Combination, Combine, Function, Op, Place, Select};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::element_wise::ElementWiseOp;
use tract_onnx::tract_core::ops::nn::LeakyRelu;

use super::{Lowered, Lowering};

impl Lowering<'_> {
    /// A function of every number.
    pub(super) fn function(&mut self, node: &TypedNode, op: &ElementWiseOp) -> Lowered<()> {
        let from = self.operand(node, 0)?.place;
        if let Some(LeakyRelu { alpha }) = op.0.downcast_ref::<LeakyRelu>() {
            let to = self.map(Function::LeakyRelu, [*alpha, 0.0], from);
            return self.give(node, 0, to);
        }
        let to = match op.0.name().as_str() {
            "Tanh" => self.map(Function::Tanh, [0.0; 2], from),
            "Sigmoid" => self.map(Function::Sigmoid, [0.0; 2], from),
            "Silu" => self.map(Function::Silu, [0.0; 2], from),
            "Exp" => self.map(Function::Exp, [0.0; 2], from),
            "Ln" => self.map(Function::Ln, [0.0; 2], from),
            "Sqrt" => self.map(Function::Sqrt, [0.0; 2], from),
            "Abs" => self.map(Function::Absolute, [0.0; 2], from),
            "Recip" => self.map(Function::Reciprocal, [0.0; 2], from),
            "Neg" => self.map(Function::Affine, [-1.0, 0.0], from),
            "Not" => self.map(Function::Not, [0.0; 2], from),
            "Square" => self.combine(Combination::Multiply, from, from),
            "Rsqrt" => {
                let root = self.map(Function::Sqrt, [0.0; 2], from);
                self.map(Function::Reciprocal, [0.0; 2], root)
            }
            _ => return Err(self.unsupported(node, "it is no function that plans have")),
        };
        self.give(node, 0, to)
    }

    /// A cast: numbers are f32 whatever they stand for, masks 0 and 1.
    pub(super) fn cast(&mut self, node: &TypedNode, to: DatumType) -> Lowered<()> {
        let value = self.operand(node, 0)?.place;
        let from = self.model.node_input_facts(node.id);
        let from = from.ok().and_then(|facts| facts.first().map(|fact| fact.datum_type));
        let is_whole = |kind: DatumType| kind.is_integer() || kind == TDim::datum_type();
        let place = match from {
            Some(from) if to == bool::datum_type() && from != to => {
                let zero = self.map(Function::Not, [0.0; 2], value);
                self.map(Function::Not, [0.0; 2], zero)
            }
            Some(from) if is_whole(to) && from.is_float() => {
                return Err(self.unsupported(node, "plans do not cut off fractions"));
            }
            _ => value,
        };
        self.give(node, 0, place)
    }

    /// A function of two values, repeated to the same sizes.
    pub(super) fn binary(&mut self, node: &TypedNode, name: &str) -> Lowered<()> {
        let (left, right) = (self.outlet(node, 0)?, self.outlet(node, 1)?);
        if let Some(constant) = self.uniform(right)
            && let Some(place) = self.with_number(node, name, constant)?
        {
            return self.give(node, 0, place);
        }
        if let Some(constant) = self.uniform(left)
            && let Some(place) = self.number_with(node, name, constant)?
        {
            return self.give(node, 0, place);
        }
        // Plans compare in one direction.
        let (combination, left, right) = match name {
            "Add" => (Combination::Add, 0, 1),
            "Sub" | "SubF" => (Combination::Subtract, 0, 1),
            "Mul" => (Combination::Multiply, 0, 1),
            "Div" => (Combination::Divide, 0, 1),
            "Min" => (Combination::Minimum, 0, 1),
            "Max" => (Combination::Maximum, 0, 1),
            "Eq" | "NE" => (Combination::Equal, 0, 1),
            "LT" => (Combination::Less, 0, 1),
            "GT" => (Combination::Less, 1, 0),
            "LTE" => (Combination::LessOrEqual, 0, 1),
            "GTE" => (Combination::LessOrEqual, 1, 0),
            "And" => (Combination::And, 0, 1),
            "Or" => (Combination::Or, 0, 1),
            _ => return Err(self.unsupported(node, "it is no function of two that plans have")),
        };
        let shape = self.shape(node, 0)?;
        let left = self.broadcast(node, left, &shape)?;
        let single = self.operand(node, right)?.place;
        let right = if single.len == 1 { single } else { self.broadcast(node, right, &shape)? };
        let to = self.combine(combination, left, right);
        let to = if name == "NE" { self.map(Function::Not, [0.0; 2], to) } else { to };
        self.give(node, 0, to)
    }

    /// A value and a constant number on its right.
    fn with_number(&mut self, node: &TypedNode, name: &str, n: f32) -> Lowered<Option<Place>> {
        let (function, parameters) = match name {
            "Add" => (Function::Affine, [1.0, n]),
            "Sub" => (Function::Affine, [1.0, -n]),
            "Mul" => (Function::Affine, [n, 0.0]),
            "Div" if is_power_of_two(n) => (Function::Affine, [1.0 / n, 0.0]),
            "Max" if n == 0.0 => (Function::Relu, [0.0; 2]),
            "Max" => (Function::Clip, [n, f32::INFINITY]),
            "Min" => (Function::Clip, [f32::NEG_INFINITY, n]),
            _ => return Ok(None),
        };
        let shape = self.shape(node, 0)?;
        let from = self.broadcast(node, 0, &shape)?;
        Ok(n.is_finite().then(|| self.map(function, parameters, from)))
    }

    /// The same with the constant on the left.
    fn number_with(&mut self, node: &TypedNode, name: &str, n: f32) -> Lowered<Option<Place>> {
        let (function, parameters) = match name {
            "Add" => (Function::Affine, [1.0, n]),
            "Sub" => (Function::Affine, [-1.0, n]),
            "Mul" => (Function::Affine, [n, 0.0]),
            "Max" if n == 0.0 => (Function::Relu, [0.0; 2]),
            "Max" => (Function::Clip, [n, f32::INFINITY]),
            "Min" => (Function::Clip, [f32::NEG_INFINITY, n]),
            _ => return Ok(None),
        };
        let shape = self.shape(node, 0)?;
        let from = self.broadcast(node, 1, &shape)?;
        Ok(n.is_finite().then(|| self.map(function, parameters, from)))
    }

    /// One of two values, by a condition.
    pub(super) fn select(&mut self, node: &TypedNode) -> Lowered<()> {
        let shape = self.shape(node, 0)?;
        let condition = self.broadcast(node, 0, &shape)?;
        let (yes, no) = (self.choice(node, 1, &shape)?, self.choice(node, 2, &shape)?);
        let to = self.arena.place(condition.len as usize);
        self.ops.push(Op::Select(Select { condition, yes, no, to }));
        self.give(node, 0, to)
    }

    /// A single number as it is, else repeated.
    fn choice(&mut self, node: &TypedNode, slot: usize, shape: &[usize]) -> Lowered<Place> {
        let place = self.operand(node, slot)?.place;
        if place.len == 1 { Ok(place) } else { self.broadcast(node, slot, shape) }
    }

    /// What an LSTM does behind its products: gates input, output, forget, candidate; then the output and the cell.
    pub(super) fn lstm(&mut self, node: &TypedNode, hidden: usize) -> Lowered<()> {
        let (gates, cell) = (self.operand(node, 0)?.place, self.operand(node, 1)?.place);
        if gates.len as usize != 4 * hidden || cell.len as usize != hidden {
            return Err(self.unsupported(node, "plans run an LSTM for one step of one sequence"));
        }
        let part = |place: Place, first: usize, count: usize| Place {
            offset: place.offset + (first * hidden) as u32,
            len: (count * hidden) as u32,
        };
        let open = self.map(Function::Sigmoid, [0.0; 2], part(gates, 0, 3));
        let candidate = self.map(Function::Tanh, [0.0; 2], part(gates, 3, 1));
        let kept = self.combine(Combination::Multiply, part(open, 2, 1), cell);
        let added = self.combine(Combination::Multiply, part(open, 0, 1), candidate);
        let (left, to) = (kept, kept);
        self.ops.push(Op::Combine(Combine {
            combination: Combination::Add,
            left,
            right: added,
            to,
        }));
        let bounded = self.map(Function::Tanh, [0.0; 2], kept);
        let output = self.combine(Combination::Multiply, bounded, part(open, 1, 1));
        self.give(node, 0, output)?;
        self.give(node, 1, kept)
    }
}

/// Whether dividing by it is multiplying by its inverse, to the bit.
fn is_power_of_two(n: f32) -> bool {
    n.is_normal() && n.to_bits() & 0x007f_ffff == 0
}
