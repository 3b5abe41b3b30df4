//! Embeddings as integers: how they stand in the arena.
//!
//! Rows of int16, each filled up with zeros to a multiple of 32, then for every row what an integer of it counts, f32.

use zerocopy::{FromBytes, IntoBytes};

use super::int8_layer::{as_integers, quantised_floats};
use crate::kernels::int8::IntegerRows;
use crate::policy::DecideError;

/// Floats of the rows of `n_max` entities of `width` columns, and one more.
pub(super) fn rows_floats(n_max: u32, width: u16) -> u64 {
    (u64::from(n_max) + 1).saturating_mul(quantised_floats(width.into()) as u64 + 1)
}

/// The floats that hold integers, of all floats of the rows.
fn integers_floats(all: usize, width: usize) -> usize {
    let of_row = quantised_floats(width);
    all.checked_div(of_row + 1).unwrap_or(0).saturating_mul(of_row)
}

/// Rows that are being written.
pub(super) struct RowsMut<'a> {
    integers: &'a mut [i16],
    steps: &'a mut [f32],
    width: usize,
}

impl<'a> RowsMut<'a> {
    pub(super) fn new(floats: &'a mut [f32], width: usize) -> Result<Self, DecideError> {
        let middle = integers_floats(floats.len(), width);
        let (integers, steps) =
            floats.split_at_mut_checked(middle).ok_or(DecideError::BadLength)?;
        let integers = <[i16]>::mut_from_bytes(integers.as_mut_bytes());
        let integers = integers.map_err(|_| DecideError::BadLength)?;
        Ok(Self { integers, steps, width: 2 * quantised_floats(width) })
    }

    /// The rows, each with what its integers count.
    #[inline(always)]
    pub(super) fn iter(&mut self) -> impl Iterator<Item = (&mut [i16], &mut f32)> {
        self.integers.chunks_exact_mut(self.width.max(1)).zip(self.steps.iter_mut())
    }
}

/// Rows that were written, those of the given slots.
#[inline(always)]
pub(super) fn rows<'a>(
    floats: &'a [f32],
    width: usize,
    slots: &'a [u16],
) -> Result<IntegerRows<'a>, DecideError> {
    let middle = integers_floats(floats.len(), width);
    let (integers, steps) = floats.split_at_checked(middle).ok_or(DecideError::BadLength)?;
    let integers = as_integers(integers)?;
    Ok(IntegerRows { integers, width: 2 * quantised_floats(width), steps, slots })
}
