//! A layer on one vector, of int8 weights.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::int8_layer::{Between, From, Int8Layer, product, quantised_floats, team_products};
use super::operator::Operator;
use super::team::Team;
use super::{Flag, LAYOUT_INT8, Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// `W x + b`, with a ReLU where one follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8Dense {
    /// The layer.
    pub layer: Int8Layer,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// The input, as long as the layer's inputs.
    pub from: Place,
    /// The output, as long as the layer's padded outputs.
    pub to: Place,
    /// The quantised input.
    pub quantised: Place,
}

impl Operator for Int8Dense {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        self.layer.check(sizes)
            && sizes.hold_apart(&[&self.from, &self.to, &self.quantised])
            && self.from.len == u32::from(self.layer.inputs)
            && self.to.len as usize == self.layer.padded_outputs()
            && self.quantised.len as usize == quantised_floats(self.layer.inputs.into())
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        // The quantised input is nobody else's to read.
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        self.layer.shape().multiply_adds()
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let wanted = [&self.from, &self.quantised, &self.to];
        let [from, quantised, to] = places(scratch.floats, wanted)?;
        product(kernels, &self.layer.matrix(weights, self.relu.is_set())?, from, quantised, to)
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        [self.from, self.to, self.quantised].iter().all(|place| place.offset >= shared)
    }

    /// As [`Self::run`] for all members of a team.
    fn run_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        _: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let Self { from, quantised, to, .. } = self;
        let matrix = self.layer.matrix(weights, self.relu.is_set())?;
        let between = Between { from: From::Floats(from), quantised, to };
        team_products(kernels, &matrix, team, between, |_| true)
    }
}
