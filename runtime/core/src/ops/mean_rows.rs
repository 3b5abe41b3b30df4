//! The mean of some rows.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::{LAYOUT_TILES, Place, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::product::padded;
use crate::policy::{DecideError, Observation};

/// Which rows a mean is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u16)]
#[non_exhaustive]
pub enum Members {
    /// All present entities.
    Present,
    /// All agents; an absent one counts as a row of zeros.
    Agents,
}

/// The mean of the rows of some entities; zeros where there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MeanRows {
    /// The rows, `[n_max, padded width]` or longer.
    pub rows: Place,
    /// Width of a row.
    pub width: u16,
    /// Whose rows.
    pub members: Members,
    /// The mean, padded.
    pub to: Place,
}

impl Operator for MeanRows {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        self.width > 0
            && sizes.holds_rows(&self.rows, self.padded_width())
            && self.to.len as usize == self.padded_width()
            && sizes.hold_apart(&[&self.rows, &self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (visible, agents) = (scratch.present, scratch.agents);
        let count = match self.members {
            Members::Present => visible.len(),
            Members::Agents => agents.len(),
        };
        let [rows, to] = places(scratch.floats, [&self.rows, &self.to])?;
        to.fill(0.0);
        for (entity, row) in visible.iter().zip(rows.chunks_exact(self.padded_width())) {
            if self.members == Members::Present || agents.contains(entity) {
                for (sum, value) in to.iter_mut().zip(row) {
                    *sum += value;
                }
            }
        }
        let count = count.max(1) as f32;
        for sum in to {
            *sum /= count;
        }
        Ok(())
    }
}

impl MeanRows {
    fn padded_width(&self) -> usize {
        padded(usize::from(self.width))
    }
}
