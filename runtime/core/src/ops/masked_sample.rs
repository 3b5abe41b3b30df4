//! The drawn choice among the available actions.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::team::Team;
use super::{Place, Places, Scratch, Sizes};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// A draw ([`crate::choose::masked_sample`]); its input is the program's logits `[U]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MaskedSample {
    /// The logits, as many as there are actions.
    pub from: Place,
}

impl Operator for MaskedSample {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        sizes.holds(&self.from) && self.from.len == sizes.actions
    }

    fn reads(&self) -> Places {
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
        // Only marks where the caller reads.
        Ok(())
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        self.from.offset >= shared
    }

    #[inline(always)]
    fn run_team(
        &self,
        _: impl Kernels,
        _: &[f32],
        _: &[Observation<'_>],
        _: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        // Only marks where the caller reads.
        Ok(())
    }
}
