//! The product of two values.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, apart};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// Products of matrices, as many as the left value has: `[rows, inner]` times `[inner, columns]`. Sums run over `inner`
/// in rising order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Multiply {
    /// Rows of a left matrix.
    pub rows: u32,
    /// Its columns, and rows of a right one.
    pub inner: u32,
    /// Columns of a right matrix.
    pub columns: u32,
    /// The left matrices.
    pub left: Place,
    /// The right matrices, as many.
    pub right: Place,
    /// The products, apart from both.
    pub to: Place,
}

impl Operator for Multiply {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        let size = |a: u32, b: u32| u64::from(a) * u64::from(b);
        let (left, right) = (size(self.rows, self.inner), size(self.inner, self.columns));
        let to = size(self.rows, self.columns);
        let count = u64::from(self.left.len).checked_div(left).unwrap_or(0);
        let fits = |place: &Place, each: u64| {
            each > 0 && count.checked_mul(each) == Some(u64::from(place.len))
        };
        count > 0
            && fits(&self.left, left)
            && fits(&self.right, right)
            && fits(&self.to, to)
            && sizes.hold_apart(&[&self.left, &self.to])
            && sizes.hold_apart(&[&self.right, &self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        u64::from(self.left.len) * u64::from(self.columns)
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
        kernels: K,
        _: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (sources, to) = apart(scratch.floats, &self.to)?;
        let (left, right) = (sources.get(&self.left)?, sources.get(&self.right)?);
        let [rows, inner, columns] = [self.rows, self.inner, self.columns].map(|n| n as usize);
        let matrices = left.chunks_exact((rows * inner).max(1));
        let matrices = matrices.zip(right.chunks_exact((inner * columns).max(1)));
        for ((left, right), to) in matrices.zip(to.chunks_exact_mut((rows * columns).max(1))) {
            kernels.multiply(left, right, [inner, columns], to);
        }
        Ok(())
    }
}
