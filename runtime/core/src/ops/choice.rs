//! The choices among the available actions.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::team::Team;
use super::{Place, Places, Scratch, Sizes};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// A choice: what runs does nothing, its place alone says where the caller reads.
macro_rules! choice {
    ($(#[$says:meta])+ $name:ident, $(#[$from:meta])+) => {
        $(#[$says])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
        #[repr(C)]
        pub struct $name {
            $(#[$from])+
            pub from: Place,
        }

        impl Operator for $name {
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
                Ok(())
            }
        }
    };
}

choice! {
    /// Greedy choice ([`crate::choose::masked_argmax`]); its input is the program's utilities `[U]`.
    MaskedArgmax,
    /// The utilities, as many as there are actions.
}

choice! {
    /// A draw ([`crate::choose::masked_sample`]); its input is the program's logits `[U]`.
    MaskedSample,
    /// The logits, as many as there are actions.
}
