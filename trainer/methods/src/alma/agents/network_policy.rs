//! The network in training as a policy, agent by agent, as deployment asks for it.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, NO_ACTION, Observation, Policy};

use super::utility::UtilityNetwork;

use super::utility_pass::UtilityPass;

use super::utility_input::UtilityInput;

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
#[derive(Debug)]
pub struct NetworkPolicy<'a> {
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    input: UtilityInput,
    utilities: Vec<f32>,
}

impl<'a> NetworkPolicy<'a> {
    /// Decides with a network.
    pub fn new(network: &'a UtilityNetwork) -> Self {
        let shape = network.shape();
        Self {
            network,
            pass: UtilityPass::new(shape),
            input: UtilityInput::default(),
            utilities: vec![0.0; shape.actions],
        }
    }

    /// What the last answer attended to: every visible entity of `observation`, which must be the one
    /// that was answered, with its weights `[heads]`; those of one head sum to 1.
    pub fn attention(
        &self,
        observation: &Observation<'_>,
    ) -> impl Iterator<Item = (usize, &[f32])> {
        let own = observation.self_index;
        let visible = observation.visible;
        let own_first = visible.contains(own).then_some(own);
        let others: Vec<usize> = visible.iter().filter(|entity| *entity != own).collect();
        let weights = self.pass.attention(&self.input);
        own_first.into_iter().chain(others).zip(weights.chunks_exact(self.network.shape().heads))
    }

    /// The agent's own row comes first, as the query; what it sees follows.
    fn fill(&mut self, observation: &Observation<'_>) -> Result<(), DecideError> {
        let own = observation.self_index;
        let others = observation.visible.iter().filter(|entity| *entity != own);
        self.input.clear();
        for (place, entity) in std::iter::once(own).chain(others).enumerate() {
            self.push_row(observation, entity)?;
            if place > 0 || observation.visible.contains(own) {
                self.input.visible.push(place);
            }
        }
        self.input.visible.end_list();
        Ok(())
    }

    /// Features of an entity: the columns before its last action.
    fn features(&self) -> usize {
        let shape = self.network.shape();
        shape.input - shape.actions
    }

    fn push_row(
        &mut self,
        observation: &Observation<'_>,
        entity: usize,
    ) -> Result<(), DecideError> {
        let features = self.features();
        let row = observation.rows.get(entity * observation.stride..);
        let row = row.and_then(|row| row.get(..features)).ok_or(DecideError::BadLength)?;
        for (column, value) in row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            self.input.rows.push(column, *value);
        }
        let last_action = observation.last_actions.get(entity).filter(|&&last| last != NO_ACTION);
        if let Some(action) = last_action {
            self.input.rows.push(features + usize::from(*action), 1.0);
        }
        self.input.rows.end_row();
        Ok(())
    }
}

impl Policy for NetworkPolicy<'_> {
    fn actions(&self) -> usize {
        self.network.shape().actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.fill(observation)?;
        let computed = self.pass.forward(self.network, &self.input);
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(computed);
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = std::mem::take(&mut self.utilities);
        let decision = self
            .utilities(observation, &mut utilities)
            .and_then(|()| masked_argmax(&utilities, observation.available));
        self.utilities = utilities;
        decision
    }
}
