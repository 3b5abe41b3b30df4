//! What a policy remembers from one decision to the next.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// One recurrent state: the caller's stands at `from` before the program runs, the next one at `to` behind it. The
/// caller's states stand one behind the other, in the order of these operators.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct State {
    /// The state.
    pub from: Place,
    /// The next one, as long.
    pub to: Place,
}

impl Operator for State {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        // Both may share floats: one is written before the first operator, the other read behind the last.
        sizes.holds(&self.from) && sizes.holds(&self.to) && self.from.len == self.to.len
    }

    fn writes(&self) -> Places {
        Places::of([self.from])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        _: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        // The caller's state is copied before the first operator and behind the last.
        Ok(())
    }
}
