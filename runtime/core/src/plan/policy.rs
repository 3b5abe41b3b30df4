//! Policies over inputs of fixed sizes.

use super::{Network, Plan, finite};
use crate::choose::{masked_argmax, masked_sample};
use crate::entity_mask::EntityMask;
use crate::ops::{OperatorSet, Place, Scratch};
use crate::policy::{DecideError, Decision, Observation};

/// What a policy decides on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given<'a> {
    /// The inputs, in the plan's order and of its lengths.
    pub inputs: &'a [&'a [f32]],
    /// Availability of actions `[U]`, 0 = not available.
    pub available: &'a [u16],
}

impl<S: OperatorSet> Plan<'_, S> {
    /// How many numbers each input of a policy has, in the caller's order.
    pub fn inputs(&self) -> impl Iterator<Item = usize> {
        self.program.inputs().map(|input| input.to.len as usize)
    }

    /// How many numbers each output has, in the order of the source graph.
    pub fn outputs(&self) -> impl Iterator<Item = usize> {
        self.program.outputs().map(|output| output.width as usize)
    }

    /// How many numbers each recurrent state of a policy has, in the order in which the caller keeps them.
    pub fn states(&self) -> impl Iterator<Item = usize> {
        self.program.states().map(|state| state.from.len as usize)
    }

    /// Whether the policy's action is one of [`Plan::actions`] that [`Plan::choose`] chooses.
    pub fn chooses(&self) -> bool {
        self.program.utilities().is_some()
    }

    /// Whether [`Plan::draw`] draws it.
    pub fn draws(&self) -> bool {
        self.program.draws()
    }

    /// Writes the outputs of a policy, one after the other in the order of the source graph. `states` `[R]` holds the
    /// recurrent states one behind the other; they are replaced where the outputs could be computed.
    ///
    /// # Errors
    /// `BadLength` where inputs, outputs or the arena do not fit or the plan is no policy with outputs, `HiddenState`
    /// where the states do not, `NonFinite` where an input, an output or a state is no finite number.
    pub fn respond(
        &self,
        arena: &mut [u8],
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), DecideError> {
        if outputs.is_empty() || outputs.len() != self.program.output_count() {
            return Err(DecideError::BadLength);
        }
        let scratch = self.run_given(arena, inputs, states)?;
        for (output, to) in self.program.outputs().zip(outputs) {
            output.read(&scratch, to)?;
        }
        self.remember(scratch.floats, states)
    }

    /// Chooses greedily among the available actions, lowest index on ties.
    ///
    /// # Errors
    /// As [`Self::respond`], and `NoAvailableAction`.
    pub fn choose(
        &self,
        arena: &mut [u8],
        given: &Given<'_>,
        states: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let scratch = self.run_given(arena, given.inputs, states)?;
        let decision = masked_argmax(self.chosen(scratch.floats)?, given.available)?;
        self.remember(scratch.floats, states)?;
        Ok(decision)
    }

    /// Draws an action from the policy's logits by 32 random bits.
    ///
    /// # Errors
    /// As [`Self::choose`], and `Greedy` where the policy does not draw.
    pub fn draw(
        &self,
        arena: &mut [u8],
        given: &Given<'_>,
        states: &mut [f32],
        random: u32,
    ) -> Result<Decision, DecideError> {
        if !self.program.draws() {
            return Err(DecideError::Greedy);
        }
        let scratch = self.run_given(arena, given.inputs, states)?;
        let decision = masked_sample(self.chosen(scratch.floats)?, given.available, random)?;
        self.remember(scratch.floats, states)?;
        Ok(decision)
    }

    /// The utilities of a policy for what an agent of a team observes.
    pub(super) fn run_in_team<'s>(
        &self,
        arena: &'s mut [u8],
        observation: &Observation<'_>,
        states: &mut [f32],
    ) -> Result<&'s [f32], DecideError> {
        let scratch = self.run_policy(arena, None, observation, states)?;
        let floats: &'s [f32] = scratch.floats;
        let utilities = self.chosen(floats)?;
        self.remember(floats, states)?;
        Ok(utilities)
    }

    fn chosen<'s>(&self, floats: &'s [f32]) -> Result<&'s [f32], DecideError> {
        let place = self.program.utilities().ok_or(DecideError::BadLength)?;
        finite(floats.get(place.range()).ok_or(DecideError::BadLength)?)
    }

    fn run_given<'s>(
        &self,
        arena: &'s mut [u8],
        inputs: &'s [&'s [f32]],
        states: &[f32],
    ) -> Result<Scratch<'s>, DecideError> {
        if self.header.network != Network::Policy || inputs.len() != self.program.input_count() {
            return Err(DecideError::BadLength);
        }
        let nothing = Observation {
            rows: &[],
            stride: self.header.features as usize,
            last_actions: &[],
            visible: EntityMask::EMPTY,
            self_index: 0,
            available: &[],
        };
        self.run_policy(arena, Some(inputs), &nothing, states)
    }

    /// Runs on what a caller gives, or else on what an agent observes.
    fn run_policy<'s>(
        &self,
        arena: &'s mut [u8],
        inputs: Option<&'s [&'s [f32]]>,
        observation: &Observation<'_>,
        states: &[f32],
    ) -> Result<Scratch<'s>, DecideError> {
        let (want, got) = (self.hidden(), states.len());
        if got != want {
            return Err(DecideError::HiddenState { want, got });
        }
        let mut scratch = self.scratch(arena, observation)?;
        scratch.inputs = inputs;
        let mut rest = states;
        for state in self.program.states() {
            let from = rest.split_off(..state.from.len as usize).ok_or(DecideError::BadLength)?;
            finite(from)?;
            copy(from, floats(&mut scratch, &state.from)?);
        }
        self.run_steps(observation, &mut scratch)?;
        Ok(scratch)
    }

    /// Hands the next states to the caller, all of them or none.
    fn remember(&self, floats: &[f32], states: &mut [f32]) -> Result<(), DecideError> {
        if states.is_empty() {
            return Ok(());
        }
        let next = |place: &Place| floats.get(place.range()).ok_or(DecideError::BadLength);
        for state in self.program.states() {
            finite(next(&state.to)?)?;
        }
        let mut rest = states;
        for state in self.program.states() {
            let to = rest.split_off_mut(..state.to.len as usize).ok_or(DecideError::BadLength)?;
            copy(next(&state.to)?, to);
        }
        Ok(())
    }
}

fn floats<'s>(scratch: &'s mut Scratch<'_>, place: &Place) -> Result<&'s mut [f32], DecideError> {
    scratch.floats.get_mut(place.range()).ok_or(DecideError::BadLength)
}

/// Copies as many numbers as both have, which checks made the same; no optimiser has to know that.
fn copy(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
