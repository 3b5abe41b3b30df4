//! What the caller reads of a network over all entities.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::{Place, Places, Scratch, Sizes, place};
use crate::kernels::Kernels;
use crate::kernels::product::padded;
use crate::limits;
use crate::math::all_finite;
use crate::policy::{DecideError, Observation};

/// What the rows of an output stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u16)]
#[non_exhaustive]
pub enum OutputRows {
    /// One row.
    One,
    /// A row for every entity; those of absent ones are zeros.
    Entities,
    /// A row for every group.
    Groups,
}

/// One output of a network that has several; outputs come in the order of the source graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Output {
    /// The values; a row is padded.
    pub from: Place,
    /// Floats of a row, without padding.
    pub width: u32,
    /// What the rows stand for.
    pub rows: OutputRows,
    /// Number of groups, 0 where rows stand for something else.
    pub groups: u16,
}

impl Operator for Output {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        if self.width == 0 || self.width > u32::from(u16::MAX) {
            return false;
        }
        let padded = padded(self.width as usize);
        let fits = match self.rows {
            OutputRows::One => self.from.len as usize == padded,
            OutputRows::Entities => sizes.holds_rows(&self.from, padded),
            OutputRows::Groups => {
                usize::from(self.groups) <= limits::TASKS
                    && self.from.len as usize == usize::from(self.groups) * padded
            }
        };
        fits && sizes.holds(&self.from)
    }

    fn reads(&self) -> Places {
        Places::of([Place { len: self.width, ..self.from }])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        _: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        // Only marks where the caller reads.
        Ok(())
    }
}

impl Output {
    /// Copies the values out, padding left behind.
    pub(crate) fn read(&self, scratch: &Scratch<'_>, to: &mut [f32]) -> Result<(), DecideError> {
        let width = self.width as usize;
        let rows = place(scratch.floats, &self.from)?.chunks_exact(padded(width));
        match self.rows {
            OutputRows::One | OutputRows::Groups => {
                if to.len() != width * rows.len() {
                    return Err(DecideError::BadLength);
                }
                for (to, row) in to.chunks_exact_mut(width.max(1)).zip(rows) {
                    copy(row, to)?;
                }
            }
            OutputRows::Entities => {
                to.fill(0.0);
                for (entity, row) in scratch.present.iter().zip(rows) {
                    let start = entity.saturating_mul(width);
                    let to = to.get_mut(start..start.saturating_add(width));
                    copy(row, to.ok_or(DecideError::BadLength)?)?;
                }
            }
        }
        Ok(())
    }
}

/// Copies a row without its padding.
fn copy(row: &[f32], to: &mut [f32]) -> Result<(), DecideError> {
    for (to, from) in to.iter_mut().zip(row) {
        *to = *from;
    }
    all_finite(to).then_some(()).ok_or(DecideError::NonFinite)
}
