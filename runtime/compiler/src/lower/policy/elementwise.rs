//! Functions of numbers: of one value, of two, of a condition.

use std::f32::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

use sortie_core::internal::ops::{Combination, Function, Op, Place, Select};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::element_wise::ElementWiseOp;
use tract_onnx::tract_core::ops::math::PowConst;
use tract_onnx::tract_core::ops::nn::{LeakyRelu, Softmax, SoftmaxKind};

use super::{Lowered, Lowering};

impl Lowering<'_> {
    /// A function of every number.
    pub(super) fn function(&mut self, node: &TypedNode, op: &ElementWiseOp) -> Lowered<()> {
        let from = self.operand(node, 0)?.place;
        if let Some(PowConst { exponent }) = op.0.downcast_ref::<PowConst>() {
            let to = self.power(node, from, *exponent)?;
            return self.give(node, 0, to);
        }
        if let Some(LeakyRelu { alpha }) = op.0.downcast_ref::<LeakyRelu>() {
            let to = self.map(Function::LeakyRelu, [*alpha, 0.0], from);
            return self.give(node, 0, to);
        }
        if let Some(x) = self.softplus_of(node, op) {
            let x = self.value(x)?.place;
            let to = self.map(Function::Softplus, [0.0; 2], x);
            return self.give(node, 0, to);
        }
        let before = self.model.node(self.outlet(node, 0)?.node);
        if let ("Ln", Some(softmax)) = (op.0.name().as_str(), before.op_as::<Softmax>())
            && softmax.kind == SoftmaxKind::Softmax
        {
            let to = self.logarithm_of_shares(before, softmax)?;
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
            "Erf" => self.map(Function::Erf, [0.0; 2], from),
            "Floor" => self.map(Function::Floor, [0.0; 2], from),
            "RoundHalfToEven" => self.map(Function::Round, [0.0; 2], from),
            "Sign" => self.map(Function::Sign, [0.0; 2], from),
            "Sin" => self.map(Function::Sine, [0.0; 2], from),
            "Cos" => self.map(Function::Cosine, [0.0; 2], from),
            "Ceil" => {
                let negated = self.map(Function::Affine, [-1.0, 0.0], from);
                let floor = self.map(Function::Floor, [0.0; 2], negated);
                self.map(Function::Affine, [-1.0, 0.0], floor)
            }
            "GeluExact" => {
                let scaled = self.map(Function::Affine, [FRAC_1_SQRT_2, 0.0], from);
                let erf = self.map(Function::Erf, [0.0; 2], scaled);
                self.times_line(from, erf, [0.5, 0.5])
            }
            "GeluApproximate" => {
                // √(2/π) (x + 0.044715 x³)
                let square = self.combine(Combination::Multiply, from, from);
                let root = core::f32::consts::FRAC_2_PI.sqrt();
                let angle = self.times_line(from, square, [0.044715 * root, root]);
                let tanh = self.map(Function::Tanh, [0.0; 2], angle);
                self.times_line(from, tanh, [0.5, 0.5])
            }
            "HardSwish" => {
                let line = self.map(Function::Affine, [1.0 / 6.0, 0.5], from);
                let gate = self.map(Function::Clip, [0.0, 1.0], line);
                self.combine(Combination::Multiply, from, gate)
            }
            "Tan" => {
                let sine = self.map(Function::Sine, [0.0; 2], from);
                let cosine = self.map(Function::Cosine, [0.0; 2], from);
                self.combine(Combination::Divide, sine, cosine)
            }
            // The difference of two powers would cancel around zero.
            "Sinh" => {
                let tanh = self.map(Function::Tanh, [0.0; 2], from);
                let cosh = self.cosh(from);
                self.combine(Combination::Multiply, tanh, cosh)
            }
            "Cosh" => self.cosh(from),
            // |x| + x² / (1 + √(1 + x²)) is e to the result's size, less one.
            "Asinh" => {
                let size = self.map(Function::Absolute, [0.0; 2], from);
                let square = self.combine(Combination::Multiply, from, from);
                let sum = self.map(Function::Affine, [1.0, 1.0], square);
                let root = self.map(Function::Sqrt, [0.0; 2], sum);
                let below = self.map(Function::Affine, [1.0, 1.0], root);
                let rest = self.combine(Combination::Divide, square, below);
                let beyond = self.combine(Combination::Add, size, rest);
                let place = self.logarithm_beyond_one(beyond);
                let sign = self.map(Function::Sign, [0.0; 2], from);
                self.combine(Combination::Multiply, place, sign)
            }
            // With t = x - 1: t + √(t (t + 2))
            "Acosh" => {
                let beyond = self.map(Function::Affine, [1.0, -1.0], from);
                let other = self.map(Function::Affine, [1.0, 1.0], from);
                let square = self.combine(Combination::Multiply, beyond, other);
                let root = self.map(Function::Sqrt, [0.0; 2], square);
                let beyond = self.combine(Combination::Add, beyond, root);
                self.logarithm_beyond_one(beyond)
            }
            // Half the logarithm of 1 + 2 |x| / (1 - |x|)
            "Atanh" => {
                let size = self.map(Function::Absolute, [0.0; 2], from);
                let below = self.map(Function::Affine, [-1.0, 1.0], size);
                let ratio = self.combine(Combination::Divide, size, below);
                let beyond = self.map(Function::Affine, [2.0, 0.0], ratio);
                let logarithm = self.logarithm_beyond_one(beyond);
                let half = self.map(Function::Affine, [0.5, 0.0], logarithm);
                let sign = self.map(Function::Sign, [0.0; 2], from);
                self.combine(Combination::Multiply, half, sign)
            }
            "Atan" => self.map(Function::ArcTangent, [0.0; 2], from),
            "Asin" => self.arc_sine(from),
            "Acos" => {
                let sine = self.arc_sine(from);
                self.map(Function::Affine, [-1.0, FRAC_PI_2], sine)
            }
            "IsNan" => {
                let is_number = self.combine(Combination::Equal, from, from);
                self.map(Function::Not, [0.0; 2], is_number)
            }
            "Square" => self.combine(Combination::Multiply, from, from),
            "Rsqrt" => {
                let root = self.map(Function::Sqrt, [0.0; 2], from);
                self.map(Function::Reciprocal, [0.0; 2], root)
            }
            _ => return Err(self.unsupported(node, "it is no function that plans have")),
        };
        self.give(node, 0, to)
    }

    /// The x of ln(1 + eˣ), as tract writes softplus: its parts one by one would end where the power does.
    fn softplus_of(&self, node: &TypedNode, op: &ElementWiseOp) -> Option<OutletId> {
        if op.0.name() != "Ln" {
            return None;
        }
        let sum = self.model.node(node.inputs.first()?.node);
        let is_sum = sum.op_as::<TypedBinOp>().is_some_and(|op| op.0.name() == "Add");
        let [left, right] = sum.inputs[..] else { return None };
        let power = match [left, right].map(|outlet| self.uniform(outlet)) {
            [Some(1.0), None] => right,
            [None, Some(1.0)] => left,
            _ => return None,
        };
        let power = self.model.node(power.node);
        let is_power = power.op_as::<ElementWiseOp>().is_some_and(|op| op.0.name() == "Exp");
        let sizes = |node: &TypedNode| self.shape(node, 0).ok();
        let found = is_sum && is_power && sizes(power) == sizes(sum);
        if found { power.inputs.first().copied() } else { None }
    }

    /// (eˣ + e⁻ˣ) / 2
    fn cosh(&mut self, x: Place) -> Place {
        let size = self.map(Function::Absolute, [0.0; 2], x);
        let power = self.map(Function::Exp, [0.0; 2], size);
        let one_over = self.map(Function::Reciprocal, [0.0; 2], power);
        let sum = self.combine(Combination::Add, power, one_over);
        self.map(Function::Affine, [0.5, 0.0], sum)
    }

    /// ln(1 + x) of x that is not negative, close to zero as well: ln(1 + eʸ) of x's logarithm y.
    fn logarithm_beyond_one(&mut self, x: Place) -> Place {
        // Of zero there is no logarithm, and beside others this number does not count.
        let x = self.map(Function::Affine, [1.0, f32::MIN_POSITIVE], x);
        let logarithm = self.map(Function::Ln, [0.0; 2], x);
        self.map(Function::Softplus, [0.0; 2], logarithm)
    }

    /// The arc tangent of x / √((1 - x) (1 + x))
    fn arc_sine(&mut self, x: Place) -> Place {
        let above = self.map(Function::Affine, [1.0, 1.0], x);
        let below = self.map(Function::Affine, [-1.0, 1.0], x);
        let square = self.combine(Combination::Multiply, above, below);
        let root = self.map(Function::Sqrt, [0.0; 2], square);
        let tangent = self.combine(Combination::Divide, x, root);
        self.map(Function::ArcTangent, [0.0; 2], tangent)
    }

    /// x (a y + b)
    fn times_line(&mut self, x: Place, y: Place, line: [f32; 2]) -> Place {
        let factor = self.map(Function::Affine, line, y);
        self.combine(Combination::Multiply, x, factor)
    }

    /// A power: products and a root where the exponent is a small multiple of a half, else e to the logarithm times it.
    fn power(&mut self, node: &TypedNode, x: Place, exponent: f32) -> Lowered<Place> {
        const MOST: f32 = 8.0;
        let (whole, size) = (exponent.abs().floor(), exponent.abs());
        if size == 0.0 {
            return Err(self.unsupported(node, "it is 1 whatever goes in"));
        }
        if !(size == whole || size == whole + 0.5) || size > MOST {
            let logarithm = self.map(Function::Ln, [0.0; 2], x);
            let product = self.map(Function::Affine, [exponent, 0.0], logarithm);
            let power = self.map(Function::Exp, [0.0; 2], product);
            // Below zero there is none, which the exponential does not say.
            let root = self.map(Function::Sqrt, [0.0; 2], x);
            let zero = self.map(Function::Affine, [0.0, 0.0], root);
            return Ok(self.combine(Combination::Add, power, zero));
        }
        let mut power = (size != whole).then(|| self.map(Function::Sqrt, [0.0; 2], x));
        for _ in 0..whole as usize {
            power = Some(power.map_or(x, |power| self.combine(Combination::Multiply, power, x)));
        }
        let power = power.unwrap_or(x);
        if exponent > 0.0 { Ok(power) } else { Ok(self.map(Function::Reciprocal, [0.0; 2], power)) }
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
                self.map(Function::Truncate, [0.0; 2], value)
            }
            _ => value,
        };
        self.give(node, 0, place)
    }

    /// What dividing by a number leaves over, as `fmod` has it: products of quotients up to 4096 with the upper half of the
    /// divisor's digits are exact, and so is what they leave.
    fn left_over(&mut self, from: Place, quotient: Place, divisor: f32) -> Place {
        let upper = f32::from_bits(divisor.to_bits() & 0xffff_f000);
        let parts = [upper, divisor - upper];
        parts.into_iter().filter(|part| *part != 0.0).fold(from, |rest, part| {
            let whole = self.map(Function::Affine, [part, 0.0], quotient);
            self.combine(Combination::Subtract, rest, whole)
        })
    }

    /// A function of two values, repeated to the same sizes.
    pub(super) fn binary(&mut self, node: &TypedNode, name: &str) -> Lowered<()> {
        let (left, right) = (self.outlet(node, 0)?, self.outlet(node, 1)?);
        let is_whole = |fact: &TypedFact| !fact.datum_type.is_float();
        let is_whole = self.model.outlet_fact(left).is_ok_and(is_whole);
        if name == "Rem" || name == "Div" && is_whole {
            let shape = self.shape(node, 0)?;
            let (left, right) =
                (self.broadcast(node, 0, &shape)?, self.broadcast(node, 1, &shape)?);
            let quotient = self.combine(Combination::Divide, left, right);
            let mut to = self.map(Function::Truncate, [0.0; 2], quotient);
            if name == "Rem" {
                to = match self.uniform(self.outlet(node, 1)?) {
                    Some(divisor) => self.left_over(left, to, divisor),
                    None => {
                        let whole = self.combine(Combination::Multiply, to, right);
                        self.combine(Combination::Subtract, left, whole)
                    }
                };
            }
            return self.give(node, 0, to);
        }
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
            "Eq" | "NE" | "Xor" => (Combination::Equal, 0, 1),
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
        let is_other = matches!(name, "NE" | "Xor");
        let to = if is_other { self.map(Function::Not, [0.0; 2], to) } else { to };
        self.give(node, 0, to)
    }

    /// A value and a constant number on its right.
    fn with_number(&mut self, node: &TypedNode, name: &str, n: f32) -> Lowered<Option<Place>> {
        let (function, parameters) = match name {
            "Add" => (Function::Affine, [1.0, n]),
            "Sub" => (Function::Affine, [1.0, -n]),
            "Mul" => (Function::Affine, [n, 0.0]),
            "Pow" => {
                let shape = self.shape(node, 0)?;
                let from = self.broadcast(node, 0, &shape)?;
                return self.power(node, from, n).map(Some);
            }
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
            "Pow" if n > 0.0 => {
                let shape = self.shape(node, 0)?;
                let from = self.broadcast(node, 1, &shape)?;
                let exponent = self.map(Function::Affine, [n.ln(), 0.0], from);
                return Ok(Some(self.map(Function::Exp, [0.0; 2], exponent)));
            }
            _ => return Ok(None),
        };
        let shape = self.shape(node, 0)?;
        let from = self.broadcast(node, 1, &shape)?;
        Ok(n.is_finite().then(|| self.map(function, parameters, from)))
    }

    /// One of two values, by a condition.
    pub(super) fn select(&mut self, node: &TypedNode) -> Lowered<()> {
        if let Some((outlet, alpha)) = self.elu(node) {
            let from = self.place_of(outlet)?;
            let to = self.map(Function::Elu, [alpha, 0.0], from);
            return self.give(node, 0, to);
        }
        let shape = self.shape(node, 0)?;
        let condition = self.broadcast(node, 0, &shape)?;
        let (yes, no) = (self.choice(node, 1, &shape)?, self.choice(node, 2, &shape)?);
        let to = self.arena.place(condition.len as usize);
        self.ops.push(Op::Select(Select { condition, yes, no, to }));
        self.give(node, 0, to)
    }

    /// Whether a choice is x where x is positive, else α (eˣ - 1): x and α.
    fn elu(&self, node: &TypedNode) -> Option<(OutletId, f32)> {
        let &[condition, yes, no] = node.inputs.as_slice() else { return None };
        let condition = self.model.node(condition.node);
        let name = condition.op_as::<TypedBinOp>()?.0.name();
        let &[left, right] = condition.inputs.as_slice() else { return None };
        let below = match name {
            "LT" | "LTE" => true,
            "GT" | "GTE" => false,
            _ => return None,
        };
        let (x, is_below) = match (self.uniform(left), self.uniform(right)) {
            (None, Some(0.0)) => (left, below),
            (Some(0.0), None) => (right, !below),
            _ => return None,
        };
        let (bent, kept) = if is_below { (yes, no) } else { (no, yes) };
        let (alpha, offset) = self.line_of_power(bent, x)?;
        (kept == x && offset == -alpha).then_some((x, alpha))
    }

    /// A value as a eˣ + b: a and b.
    fn line_of_power(&self, outlet: OutletId, x: OutletId) -> Option<(f32, f32)> {
        let node = self.model.node(outlet.node);
        if let Some(function) = node.op_as::<ElementWiseOp>() {
            let is_power = function.0.name() == "Exp" && node.inputs.first() == Some(&x);
            return is_power.then_some((1.0, 0.0));
        }
        let name = node.op_as::<TypedBinOp>()?.0.name();
        let &[left, right] = node.inputs.as_slice() else { return None };
        let (inner, n, is_first) = match (self.uniform(left), self.uniform(right)) {
            (None, Some(n)) => (left, n, true),
            (Some(n), None) => (right, n, false),
            _ => return None,
        };
        let (a, b) = self.line_of_power(inner, x)?;
        match name {
            "Add" => Some((a, b + n)),
            "Sub" if is_first => Some((a, b - n)),
            "Mul" => Some((a * n, b * n)),
            _ => None,
        }
    }

    /// A single number as it is, else repeated.
    fn choice(&mut self, node: &TypedNode, slot: usize, shape: &[usize]) -> Lowered<Place> {
        let place = self.operand(node, slot)?.place;
        if place.len == 1 { Ok(place) } else { self.broadcast(node, slot, shape) }
    }
}

/// Whether dividing by it is multiplying by its inverse, to the bit.
fn is_power_of_two(n: f32) -> bool {
    n.is_normal() && n.to_bits() & 0x007f_ffff == 0
}
