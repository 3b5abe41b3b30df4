//! A gated recurrent unit: what an agent remembers from step to step.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::team::Team;
use super::{Flag, LAYOUT_TILES, Linear, Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::product::{Sparse, padded};
use crate::math::{all_finite, sigmoid, tanh};
use crate::policy::{DecideError, Observation};

/// Gates of the unit, in the order of its matrices: reset r, update z, candidate n.
const GATES: usize = 3;

/// One step of a gated recurrent unit with the gates of PyTorch's `GRUCell` (dissertation section 5.2).
///
/// r = σ(W_r y + b_r + U_r h + c_r), z = σ(W_z y + b_z + U_z h + c_z),
/// n = tanh(W_n y + b_n + r (U_n h + c_n)), and the new state is n + z (h - n).
///
/// Both matrices hold the gates side by side, each padded like outputs are, so that a layer has three times
/// the padded state's outputs. The caller's state stands at `state` before the program runs; the new one, at
/// `to`, is the caller's next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Gru {
    /// Floats R of the state.
    pub size: u32,
    /// W and b, on the input.
    pub input: Linear,
    /// U and c, on the state.
    pub recurrent: Linear,
    /// Whether the input comes out of a ReLU, so that leaving out its zeros pays.
    pub sparse_input: Flag,
    /// The input y, as long as the input layer's inputs.
    pub from: Place,
    /// The state h, R floats.
    pub state: Place,
    /// W y + b, three padded gates.
    pub input_gates: Place,
    /// U h + c, three padded gates.
    pub recurrent_gates: Place,
    /// The new state, padded.
    pub to: Place,
}

impl Operator for Gru {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        if u32::from(self.recurrent.inputs) != self.size {
            return false;
        }
        let (padded, gates) = (self.padded_size(), GATES * self.padded_size());
        let layers = self.input.check(sizes)
            && self.recurrent.check(sizes)
            && usize::from(self.input.outputs) == gates
            && usize::from(self.recurrent.outputs) == gates
            && (!self.sparse_input.is_set() || sizes.lists(u64::from(self.input.inputs)));
        let lengths = self.from.len == u32::from(self.input.inputs)
            && self.state.len == self.size
            && self.input_gates.len as usize == gates
            && self.recurrent_gates.len as usize == gates
            && self.to.len as usize == padded;
        layers && lengths && sizes.hold_apart(&self.places())
    }

    fn reads(&self) -> Places {
        Places::of([self.from, self.state])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        let gates = (GATES * self.padded_size()) as u64;
        self.input.multiply_adds() + self.recurrent.multiply_adds() + gates
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let [from, state, inputs, recurrents, to] = places(scratch.floats, self.places())?;
        let matrix = self.input.matrix(weights)?;
        let around = self.input.around(weights, false)?;
        if self.sparse_input.is_set() {
            kernels.mark(from, scratch.nonzeros);
            let marks = &*scratch.nonzeros;
            let from = Sparse { values: from, marks, one: None, count: from.len() };
            kernels.sparse_product(matrix, from, around, inputs);
        } else {
            kernels.product(matrix, from, around, inputs);
        }
        let around = self.recurrent.around(weights, false)?;
        kernels.product(self.recurrent.matrix(weights)?, state, around, recurrents);
        // The gates saturate: they would turn an overflow into a number.
        if !(all_finite(inputs) && all_finite(recurrents)) {
            return Err(DecideError::NonFinite);
        }
        self.combine(inputs, recurrents, state, to).ok_or(DecideError::BadLength)
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        self.places().iter().all(|place| place.offset >= shared)
    }

    /// As [`Self::run`] for all members of a team, whose states stand at their own `state`; zeros of the input are not
    /// left out.
    #[inline(always)]
    fn run_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        _: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let layers = [
            (&self.input, &self.from, &self.input_gates),
            (&self.recurrent, &self.state, &self.recurrent_gates),
        ];
        for (layer, from, to) in layers {
            let around = layer.around(weights, false)?;
            kernels.products(layer.matrix(weights)?, &mut team.pairs(from, to, |_| true), around);
        }
        let [state, inputs, recurrents, to] =
            [self.state, self.input_gates, self.recurrent_gates, self.to]
                .map(|place| team.own_place(&place));
        for (member, floats) in team.own_places() {
            let places = [&state, &inputs, &recurrents, &to];
            let [state, inputs, recurrents, to] = super::places(floats, places)?;
            member.alone |= !(all_finite(inputs) && all_finite(recurrents));
            self.combine(inputs, recurrents, state, to).ok_or(DecideError::BadLength)?;
        }
        Ok(())
    }
}

impl Gru {
    fn padded_size(&self) -> usize {
        padded(self.size as usize)
    }

    fn places(&self) -> [&Place; 5] {
        [&self.from, &self.state, &self.input_gates, &self.recurrent_gates, &self.to]
    }

    /// Writes the new state, zeros behind it.
    #[inline(always)]
    fn combine(
        &self,
        inputs: &mut [f32],
        recurrents: &[f32],
        state: &[f32],
        to: &mut [f32],
    ) -> Option<()> {
        let padded = self.padded_size();
        let (reset, rest) = inputs.split_at_mut_checked(padded)?;
        let (update, candidate) = rest.split_at_mut_checked(padded)?;
        let (reset_of, rest) = recurrents.split_at_checked(padded)?;
        let (update_of, candidate_of) = rest.split_at_checked(padded)?;
        for (gate, recurrent) in reset.iter_mut().zip(reset_of) {
            *gate = sigmoid(*gate + recurrent);
        }
        for (gate, recurrent) in update.iter_mut().zip(update_of) {
            *gate = sigmoid(*gate + recurrent);
        }
        for ((value, gate), recurrent) in candidate.iter_mut().zip(reset).zip(candidate_of) {
            *value = tanh(*value + *gate * recurrent);
        }
        to.fill(0.0);
        let values = to.iter_mut().zip(candidate).zip(update);
        for (((to, candidate), update), state) in values.zip(state) {
            *to = *candidate + *update * (state - *candidate);
        }
        Some(())
    }
}
