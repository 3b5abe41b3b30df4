//! A layer on one vector.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::team::Team;
use super::{Flag, LAYOUT_TILES, Linear, Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::product::Sparse;
use crate::policy::{DecideError, Observation};

/// `W x + b`, with a ReLU where one follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Dense {
    /// The layer.
    pub layer: Linear,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// Whether the input comes out of a ReLU, so that leaving out its zeros pays.
    pub sparse_input: Flag,
    /// The input, as long as the layer's inputs.
    pub from: Place,
    /// The output, as long as the layer's padded outputs.
    pub to: Place,
}

impl Operator for Dense {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        self.layer.check(sizes)
            && sizes.holds(&self.from)
            && sizes.holds(&self.to)
            && self.from.disjoint(&self.to)
            && self.from.len == u32::from(self.layer.inputs)
            && self.to.len as usize == self.layer.padded_outputs()
            && (!self.sparse_input.is_set() || sizes.lists(u64::from(self.layer.inputs)))
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        self.layer.multiply_adds()
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let matrix = self.layer.matrix(weights)?;
        let [from, to] = places(scratch.floats, [&self.from, &self.to])?;
        let around = self.layer.around(weights, self.relu.is_set())?;
        if self.sparse_input.is_set() {
            kernels.mark(from, scratch.nonzeros);
            let marks = &*scratch.nonzeros;
            let inputs = Sparse { values: from, marks, one: None, count: from.len() };
            kernels.sparse_product(matrix, inputs, around, to);
        } else {
            kernels.product(matrix, from, around, to);
        }
        Ok(())
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        self.from.offset.min(self.to.offset) >= shared
    }

    /// As [`Self::run`] for all members of a team, zeros not left out: which they are differs between members.
    fn run_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        _: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let around = self.layer.around(weights, self.relu.is_set())?;
        let pairs = &mut team.pairs(&self.from, &self.to, |_| true);
        kernels.products(self.layer.matrix(weights)?, pairs, around);
        Ok(())
    }
}
