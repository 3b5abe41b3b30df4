//! Numbers in another order: transposed, cut out, repeated, put beside others.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, apart};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// Most dimensions of a copy.
pub(super) const DIMENSIONS: usize = 4;

/// Numbers of a row that is short.
const SHORT: usize = 8;

/// Copies the numbers of a grid: the one at indices i stands `i · from_strides` behind the source's start, and goes
/// `i · to_strides` behind the result's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Arrange {
    /// The source.
    pub from: Place,
    /// The result, apart from it.
    pub to: Place,
    /// Numbers along every dimension, at least one.
    pub sizes: [u32; DIMENSIONS],
    /// Steps in the source; 0 repeats.
    pub from_strides: [u32; DIMENSIONS],
    /// Steps in the result.
    pub to_strides: [u32; DIMENSIONS],
}

impl Operator for Arrange {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        self.sizes.iter().all(|size| *size > 0)
            && self.last(&self.from_strides) < u64::from(self.from.len)
            && self.last(&self.to_strides) < u64::from(self.to.len)
            && sizes.hold_apart(&[&self.from, &self.to])
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        // Several copies may fill a value together, such as parts that stand beside each other.
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
        let (sources, to) = apart(scratch.floats, &self.to)?;
        let from = sources.get(&self.from)?;
        let mut sizes = self.sizes.map(|size| size as usize);
        let mut from_strides = self.from_strides.map(|stride| stride as usize);
        let mut to_strides = self.to_strides.map(|stride| stride as usize);
        // The longer of the last two inside: a row of three numbers takes longer to begin than to copy.
        let [.., rows, columns] = sizes;
        if columns < SHORT && columns < rows {
            for along in [&mut sizes, &mut from_strides, &mut to_strides] {
                along.swap(2, 3);
            }
        }
        let [planes, blocks, rows, columns] = sizes;
        for plane in 0..planes {
            for block in 0..blocks {
                for row in 0..rows {
                    let start = |[of_plane, of_block, of_row, _]: [usize; DIMENSIONS]| {
                        plane * of_plane + block * of_block + row * of_row
                    };
                    let from = from.get(start(from_strides)..).ok_or(DecideError::BadLength)?;
                    let to = to.get_mut(start(to_strides)..).ok_or(DecideError::BadLength)?;
                    copy_row(columns, from, from_strides[3], to, to_strides[3])?;
                }
            }
        }
        Ok(())
    }
}

impl Arrange {
    /// The place of the last number.
    fn last(&self, strides: &[u32; DIMENSIONS]) -> u64 {
        let sizes = self.sizes.iter().zip(strides);
        let steps = sizes.map(|(size, stride)| {
            u64::from(size.saturating_sub(1)).saturating_mul(u64::from(*stride))
        });
        steps.fold(0, u64::saturating_add)
    }
}

/// Copies so many numbers.
#[inline(always)]
fn copy_row(
    count: usize,
    from: &[f32],
    from_stride: usize,
    to: &mut [f32],
    to_stride: usize,
) -> Result<(), DecideError> {
    // Checked once and not for each number.
    let len = |stride: usize| count.saturating_sub(1).saturating_mul(stride).saturating_add(1);
    let from = from.get(..len(from_stride)).ok_or(DecideError::BadLength)?;
    let to = to.get_mut(..len(to_stride)).ok_or(DecideError::BadLength)?;
    match (from_stride, to_stride) {
        // Both are as long, which no compiler sees of a copy of slices.
        (1, 1) => to.iter_mut().zip(from).for_each(|(to, from)| *to = *from),
        (0, 1) => to.fill(from.first().copied().unwrap_or_default()),
        _ => {
            // Not two iterators that leave out what is between: how much they have left is divided for.
            let (mut from_index, mut to_index) = (0, 0);
            for _ in 0..count {
                let from = from.get(from_index).ok_or(DecideError::BadLength)?;
                *to.get_mut(to_index).ok_or(DecideError::BadLength)? = *from;
                from_index += from_stride;
                to_index += to_stride;
            }
        }
    }
    Ok(())
}
