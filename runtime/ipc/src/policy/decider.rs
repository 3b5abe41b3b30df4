//! What decides on what messages carry, with the memory that it needs.

use sortie_core::choose::{masked_argmax, masked_sample};
use sortie_core::wire::Reason;

use super::engine::Engine;
use super::schema::{MOST_PORTS, PolicySchema};
use crate::random::Random;

/// An engine with the recurrent state of the policy that it runs.
pub(super) struct Decider<'e> {
    engine: &'e mut dyn Engine,
    inputs: Vec<usize>,
    outputs: Vec<usize>,
    actions: usize,
    states: Vec<f32>,
    /// What actions are drawn with; `None` = the best is taken.
    random: Option<Random>,
}

impl<'e> Decider<'e> {
    pub(super) fn new(
        engine: &'e mut dyn Engine,
        schema: &PolicySchema,
        seed: Option<u64>,
    ) -> Self {
        Self {
            engine,
            inputs: schema.inputs.iter().map(|port| port.length).collect(),
            outputs: schema.outputs.iter().map(|port| port.length).collect(),
            actions: schema.actions,
            states: vec![0.0; schema.states.iter().map(|state| state.length).sum()],
            random: seed.map(Random::new),
        }
    }

    /// Brings near what decisions read and write, and forgets what that came to.
    pub(super) fn warm(&mut self) {
        self.engine.warm();
        let unused = self.random.clone();
        let inputs = vec![0.0; self.inputs.iter().sum()];
        let mut outputs = vec![0.0; self.outputs.iter().sum()];
        // Zeros may be no observation that this policy decides on.
        let _ = self.decide(&inputs, &vec![1; self.actions], &mut outputs);
        self.forget();
        self.random = unused;
    }

    /// Begins an episode.
    pub(super) fn forget(&mut self) {
        self.states.fill(0.0);
    }

    /// Writes the outputs; returns the action, where the policy chooses one. An error leaves the state as it was.
    pub(super) fn decide(
        &mut self,
        mut inputs: &[f32],
        available: &[u16],
        outputs: &mut [f32],
    ) -> Result<Option<u16>, Reason> {
        if self.actions != 0 && available.iter().all(|&code| code == 0) {
            return Err(Reason::NoAvailableAction);
        }
        let mut given: [&[f32]; MOST_PORTS] = [&[]; MOST_PORTS];
        for (place, &length) in given.iter_mut().zip(&self.inputs) {
            *place = inputs.split_off(..length).ok_or(Reason::Length)?;
        }
        let given = given.get(..self.inputs.len()).ok_or(Reason::Length)?;
        let mut places: [&mut [f32]; MOST_PORTS] = Default::default();
        let mut rest = &mut *outputs;
        for (place, &length) in places.iter_mut().zip(&self.outputs) {
            *place = rest.split_off_mut(..length).ok_or(Reason::Length)?;
        }
        let places = places.get_mut(..self.outputs.len()).ok_or(Reason::Length)?;
        self.engine.respond(given, &mut self.states, places)?;
        if self.actions == 0 {
            return Ok(None);
        }
        let scores = outputs.get(..self.actions).ok_or(Reason::Length)?;
        let decision = match &mut self.random {
            None => masked_argmax(scores, available),
            Some(random) => masked_sample(scores, available, (random.draw() >> 32) as u32),
        };
        Ok(Some(decision.map_err(Reason::from)?.action))
    }
}
