//! What the caller gives.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::math::all_finite;
use crate::policy::{DecideError, Observation};

/// One input of a policy: its numbers are copied to the arena, and have to be finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Input {
    /// Which of the caller's inputs it is.
    pub index: u32,
    /// Where it stands, as long as the input.
    pub to: Place,
}

impl Operator for Input {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        sizes.holds(&self.to)
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
        let input = scratch.inputs.get(self.index as usize).ok_or(DecideError::BadLength)?;
        let [to] = places(scratch.floats, [&self.to])?;
        if input.len() != to.len() {
            return Err(DecideError::BadLength);
        }
        to.copy_from_slice(input);
        all_finite(to).then_some(()).ok_or(DecideError::NonFinite)
    }
}
