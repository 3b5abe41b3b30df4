//! Layer normalisation.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Flag, Place, Places, Scratch, Sizes, copied, slice};
use crate::kernels::{Kernels, dot};
use crate::math::square_root;
use crate::policy::{DecideError, Observation};

/// Brings every row to mean 0 and variance 1, or only its squares to mean 1; then multiplies its columns with factors and
/// adds offsets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Normalise {
    /// Whether the mean is taken away.
    pub centred: Flag,
    /// Numbers of a row.
    pub columns: u32,
    /// The bits of what is added to the variance.
    pub epsilon: u32,
    /// Weights: a factor for each column.
    pub factors: u32,
    /// Weights: an offset for each column.
    pub offsets: u32,
    /// The rows.
    pub from: Place,
    /// The result, as long; the rows themselves, or apart from them.
    pub to: Place,
}

impl Operator for Normalise {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        self.from.len == self.to.len
            && self.from.len.checked_rem(self.columns) == Some(0)
            && sizes.hold_in_place(&self.from, &self.to)
            && sizes.holds_weights(self.factors, self.columns.into())
            && sizes.holds_weights(self.offsets, self.columns.into())
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
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let columns = self.columns as usize;
        let factors = slice(weights, self.factors, columns)?;
        let offsets = slice(weights, self.offsets, columns)?;
        let rows = copied(scratch.floats, &self.from, &self.to)?;
        for row in rows.chunks_exact_mut(columns.max(1)) {
            if self.centred.is_set() {
                let mean = dot::sum(row) / columns as f32;
                row.iter_mut().for_each(|value| *value -= mean);
            }
            let variance = dot::sum_of_squares(row) / columns as f32;
            let scale = 1.0 / square_root(variance + f32::from_bits(self.epsilon));
            for ((value, factor), offset) in row.iter_mut().zip(factors).zip(offsets) {
                *value = *value * scale * factor + offset;
            }
        }
        Ok(())
    }
}
