//! A function of every number of a value.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, copied};
use crate::kernels::Kernels;
use crate::math;
use crate::policy::{DecideError, Observation};

/// A function of one number x, with parameters a and b.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u32)]
#[non_exhaustive]
pub enum Function {
    /// a x + b
    Affine,
    /// max(0, x)
    Relu,
    /// x where it is positive, else a x
    LeakyRelu,
    /// x where it is positive, else a (eˣ - 1)
    Elu,
    /// tanh x
    Tanh,
    /// 1 / (1 + e⁻ˣ)
    Sigmoid,
    /// ln(1 + eˣ)
    Softplus,
    /// x / (1 + |x|)
    Softsign,
    /// x / (1 + e⁻ˣ)
    Silu,
    /// x between a and b
    Clip,
    /// eˣ, x clamped to [-87, 88]
    Exp,
    /// ln x; of 0 and below something that is not finite
    Ln,
    /// √x
    Sqrt,
    /// |x|
    Absolute,
    /// 1 / x
    Reciprocal,
    /// 1 where x is 0, else 0
    Not,
    /// The error function, 2/√π times the integral of e^(-t²) from 0 to x
    Erf,
    /// The largest whole number that is not above x
    Floor,
    /// The nearest whole number, of two the even one
    Round,
    /// 1 where x is positive, -1 where it is negative, else x
    Sign,
    /// The sine
    Sine,
    /// The cosine
    Cosine,
    /// The arc tangent
    ArcTangent,
    /// x without what stands behind its point
    Truncate,
}

/// Applies a function to every number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Map {
    /// The function.
    pub function: Function,
    /// The bits of its parameter a.
    pub a: u32,
    /// The bits of its parameter b.
    pub b: u32,
    /// The value.
    pub from: Place,
    /// The result, as long; the value itself, or apart from it.
    pub to: Place,
}

impl Operator for Map {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        self.from.len == self.to.len && sizes.hold_in_place(&self.from, &self.to)
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let values = copied(scratch.floats, &self.from, &self.to)?;
        let (a, b) = (f32::from_bits(self.a), f32::from_bits(self.b));
        match self.function {
            Function::Affine => each(values, |x| a * x + b),
            Function::Relu => each(values, math::relu),
            Function::LeakyRelu => each(values, |x| if x > 0.0 { x } else { a * x }),
            Function::Elu => {
                each(values, |x| if x > 0.0 { x } else { a * math::exp_minus_one(x) });
            }
            Function::Tanh => each(values, math::tanh),
            Function::Sigmoid => each(values, math::sigmoid),
            Function::Softplus => each(values, math::softplus),
            Function::Softsign => each(values, |x| x / (1.0 + x.abs())),
            Function::Silu => each(values, |x| x * math::sigmoid(x)),
            Function::Clip => each(values, |x| clip(x, a, b)),
            Function::Exp => each(values, math::exp),
            Function::Ln => each(values, math::ln_of_any),
            Function::Sqrt => each(values, math::square_root),
            Function::Absolute => each(values, f32::abs),
            Function::Reciprocal => each(values, |x| 1.0 / x),
            Function::Not => each(values, |x| if x == 0.0 { 1.0 } else { 0.0 }),
            Function::Erf => each(values, libm::erff),
            Function::Floor => each(values, libm::floorf),
            Function::Round => each(values, libm::rintf),
            Function::Sign => each(values, sign),
            Function::Sine => each(values, math::sine),
            Function::Cosine => each(values, math::cosine),
            Function::ArcTangent => each(values, math::arc_tangent),
            Function::Truncate => each(values, libm::truncf),
        }
        Ok(())
    }
}

#[inline(always)]
fn each(values: &mut [f32], function: impl Fn(f32) -> f32) {
    for value in values {
        *value = function(*value);
    }
}

/// Zero and NaN stay what they are.
#[inline(always)]
fn sign(x: f32) -> f32 {
    match x {
        _ if x > 0.0 => 1.0,
        _ if x < 0.0 => -1.0,
        _ => x,
    }
}

/// NaN stays NaN.
#[inline(always)]
fn clip(x: f32, low: f32, high: f32) -> f32 {
    let x = if x < low { low } else { x };
    if x > high { high } else { x }
}
