//! One number of every row.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, places};
use crate::kernels::{Kernels, dot};
use crate::policy::{DecideError, Observation};

/// What becomes of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u32)]
#[non_exhaustive]
pub enum Reduction {
    /// Its sum, in 16 lanes.
    Sum,
    /// Its mean.
    Mean,
    /// Its largest number.
    Maximum,
    /// Its smallest number.
    Minimum,
    /// The place of its largest number, the first of several, as a number.
    ArgMax,
}

/// Reduces every row `[columns]` to one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Reduce {
    /// What becomes of a row.
    pub reduction: Reduction,
    /// Numbers of a row.
    pub columns: u32,
    /// The rows.
    pub from: Place,
    /// A number for each, apart from them.
    pub to: Place,
}

impl Operator for Reduce {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        self.columns > 0
            && u64::from(self.from.len) == u64::from(self.columns) * u64::from(self.to.len)
            && sizes.hold_apart(&[&self.from, &self.to])
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
        let [from, to] = places(scratch.floats, [&self.from, &self.to])?;
        let columns = self.columns as usize;
        for (row, to) in from.chunks_exact(columns.max(1)).zip(to) {
            *to = match self.reduction {
                Reduction::Sum => dot::sum(row),
                Reduction::Mean => dot::sum(row) / columns as f32,
                Reduction::Maximum => row.iter().fold(f32::NEG_INFINITY, |a, b| larger(a, *b)),
                Reduction::Minimum => -row.iter().fold(f32::NEG_INFINITY, |a, b| larger(a, -*b)),
                Reduction::ArgMax => first_largest(row) as f32,
            };
        }
        Ok(())
    }
}

/// NaN stays NaN.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a || b.is_nan() { b } else { a }
}

fn first_largest(row: &[f32]) -> usize {
    let mut best = (0, f32::NEG_INFINITY);
    for (index, value) in row.iter().enumerate() {
        if *value > best.1 {
            best = (index, *value);
        }
    }
    best.0
}
