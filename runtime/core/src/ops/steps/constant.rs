//! Numbers of the weights as a value.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, places, slice};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// Copies weights to the arena.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Constant {
    /// Where the weights start.
    pub weights: u32,
    /// Where they go.
    pub to: Place,
}

impl Operator for Constant {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        sizes.holds(&self.to) && sizes.holds_weights(self.weights, self.to.len.into())
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let [to] = places(scratch.floats, [&self.to])?;
        let from = slice(weights, self.weights, to.len())?;
        // A copy of slices would panic where their lengths differ; not every target's optimiser sees that they do not.
        for (to, from) in to.iter_mut().zip(from) {
            *to = *from;
        }
        Ok(())
    }
}
