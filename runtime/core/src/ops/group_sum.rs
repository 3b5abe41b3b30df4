//! Sums of rows, one for every group of entities.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::{LAYOUT_TILES, Place, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::product::padded;
use crate::limits;
use crate::policy::{DecideError, Observation};

/// For every group, a subtask for instance, the sum of the rows of the present entities that belong to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct GroupSum {
    /// The rows, `[n_max, padded width]` or longer.
    pub rows: Place,
    /// Width of a row.
    pub width: u16,
    /// Number of groups T; group t is bit t of what an entity belongs to.
    pub groups: u16,
    /// The sums, `[T, padded width]`.
    pub to: Place,
}

impl Operator for GroupSum {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let groups = usize::from(self.groups);
        self.width > 0
            && (1..=limits::TASKS).contains(&groups)
            && sizes.holds_rows(&self.rows, self.padded_width())
            && self.to.len as usize == groups * self.padded_width()
            && sizes.hold_apart(&[&self.rows, &self.to])
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        visible * u64::from(self.groups) * self.padded_width() as u64
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (present, groups) = (scratch.present, scratch.groups);
        let [rows, to] = places(scratch.floats, [&self.rows, &self.to])?;
        to.fill(0.0);
        for (entity, row) in present.iter().zip(rows.chunks_exact(self.padded_width())) {
            let belongs = groups.get(entity).ok_or(DecideError::BadLength)?;
            for (group, to) in (0..).zip(to.chunks_exact_mut(self.padded_width())) {
                if belongs.checked_shr(group).unwrap_or(0) & 1 == 1 {
                    for (sum, value) in to.iter_mut().zip(row) {
                        *sum += value;
                    }
                }
            }
        }
        Ok(())
    }
}

impl GroupSum {
    fn padded_width(&self) -> usize {
        padded(usize::from(self.width))
    }
}
