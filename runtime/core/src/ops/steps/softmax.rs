//! The softmax of every row.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Flag, Place, Places, Scratch, Sizes, copied};
use crate::kernels::{Kernels, dot};
use crate::math::{exp, ln};
use crate::policy::{DecideError, Observation};

/// The softmax of every row, or its logarithm. Numbers of minus infinity have weight zero; a row of nothing else is
/// not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Softmax {
    /// Whether the logarithm is wanted.
    pub logarithm: Flag,
    /// Numbers of a row.
    pub columns: u32,
    /// The rows.
    pub from: Place,
    /// The result, as long; the rows themselves, or apart from them.
    pub to: Place,
}

impl Operator for Softmax {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        self.from.len == self.to.len
            && self.from.len.checked_rem(self.columns) == Some(0)
            && sizes.hold_in_place(&self.from, &self.to)
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
        let rows = copied(scratch.floats, &self.from, &self.to)?;
        for row in rows.chunks_exact_mut((self.columns as usize).max(1)) {
            let largest = row.iter().fold(f32::NEG_INFINITY, |a, b| if *b > a { *b } else { a });
            if self.logarithm.is_set() {
                let sum = logarithm_of_sum(row, largest);
                row.iter_mut().for_each(|value| *value = *value - largest - sum);
            } else {
                // What is not a number stays none, and shows at the end.
                row.iter_mut().for_each(|value| *value = power(*value - largest));
                let scale = 1.0 / dot::sum(row);
                row.iter_mut().for_each(|value| *value *= scale);
            }
        }
        Ok(())
    }
}

/// e to a power that is at most 0; 0 for minus infinity.
#[inline(always)]
fn power(x: f32) -> f32 {
    if x == f32::NEG_INFINITY {
        0.0
    } else if x.is_nan() {
        x
    } else {
        exp(x)
    }
}

/// The logarithm of the sum of the powers of numbers less the largest.
#[inline(always)]
fn logarithm_of_sum(row: &[f32], largest: f32) -> f32 {
    let mut sum = 0.0;
    for value in row {
        sum += power(*value - largest);
    }
    if sum.is_nan() { sum } else { ln(sum) }
}
