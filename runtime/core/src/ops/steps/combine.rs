//! A function of two values, number by number.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, apart, copied};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// A function of two numbers x and y. Comparisons give 1 or 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u32)]
#[non_exhaustive]
pub enum Combination {
    /// x + y
    Add,
    /// x - y
    Subtract,
    /// x y
    Multiply,
    /// x / y
    Divide,
    /// the smaller one
    Minimum,
    /// the larger one
    Maximum,
    /// x = y
    Equal,
    /// x < y
    Less,
    /// x ≤ y
    LessOrEqual,
    /// whether both are other than 0
    And,
    /// whether one is other than 0
    Or,
}

/// Joins two values number by number; the right one may be a single number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Combine {
    /// The function.
    pub combination: Combination,
    /// x
    pub left: Place,
    /// y, as long or of one number; apart from the result.
    pub right: Place,
    /// The result, as long as x; x itself, or apart from it.
    pub to: Place,
}

impl Operator for Combine {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        self.left.len == self.to.len
            && [1, self.left.len].contains(&self.right.len)
            && sizes.hold_in_place(&self.left, &self.to)
            && sizes.hold_apart(&[&self.right, &self.to])
    }

    fn reads(&self) -> Places {
        Places::of([self.left, self.right])
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
        copied(scratch.floats, &self.left, &self.to)?;
        let (sources, to) = apart(scratch.floats, &self.to)?;
        let right = sources.get(&self.right)?;
        match self.combination {
            Combination::Add => join(to, right, |x, y| x + y),
            Combination::Subtract => join(to, right, |x, y| x - y),
            Combination::Multiply => join(to, right, |x, y| x * y),
            Combination::Divide => join(to, right, |x, y| x / y),
            Combination::Minimum => join(to, right, |x, y| if y < x { y } else { x }),
            Combination::Maximum => join(to, right, |x, y| if y > x { y } else { x }),
            Combination::Equal => join(to, right, |x, y| number(x == y)),
            Combination::Less => join(to, right, |x, y| number(x < y)),
            Combination::LessOrEqual => join(to, right, |x, y| number(x <= y)),
            Combination::And => join(to, right, |x, y| number(x != 0.0 && y != 0.0)),
            Combination::Or => join(to, right, |x, y| number(x != 0.0 || y != 0.0)),
        }
        Ok(())
    }
}

#[inline(always)]
fn join(to: &mut [f32], right: &[f32], function: impl Fn(f32, f32) -> f32) {
    if let [one] = right {
        to.iter_mut().for_each(|to| *to = function(*to, *one));
        return;
    }
    for (to, right) in to.iter_mut().zip(right) {
        *to = function(*to, *right);
    }
}

#[inline(always)]
fn number(holds: bool) -> f32 {
    if holds { 1.0 } else { 0.0 }
}
