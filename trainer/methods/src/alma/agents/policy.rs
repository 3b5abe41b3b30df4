//! The network in training as a policy, agent by agent, as deployment asks for it.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, NO_ACTION, Observation, Policy};
use sortie_envs::EntitySet;
use sortie_nn::tape::Tape;

use super::layers::{UtilityInput, UtilityLayers};
use super::utility::UtilityView;

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
#[derive(Debug)]
pub struct NetworkPolicy<'a> {
    network: UtilityView<'a>,
    tape: Tape,
    input: UtilityInput,
    /// What the last answer attended to, `[entities, heads]`.
    attention: Vec<f32>,
}

impl<'a> NetworkPolicy<'a> {
    /// Decides with a network.
    pub fn new(network: UtilityView<'a>) -> Self {
        let (tape, input) = (Tape::default(), UtilityInput::default());
        Self { network, tape, input, attention: Vec::new() }
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
        let weights = self.attention.chunks_exact(self.network.shape.heads);
        own_first.into_iter().chain(others).zip(weights)
    }

    /// The agent's own row comes first, as the query; what it sees follows.
    fn fill(&mut self, observation: &Observation<'_>) -> Result<(), DecideError> {
        let own = observation.self_index;
        let others = observation.visible.iter().filter(|entity| *entity != own);
        self.input.clear();
        let mut places = [0; EntitySet::BITS as usize];
        let mut seen: EntitySet = 0;
        for (place, entity) in std::iter::once(own).chain(others).enumerate() {
            self.push_row(observation, entity)?;
            if place > 0 || observation.visible.contains(own) {
                self.input.visible.push(place);
                places[entity] = place;
                seen |= 1 << entity;
            }
        }
        let UtilityInput { rows, visible, aims } = &mut self.input;
        visible.end_list();
        let targets = self.network.shape.targets;
        aims.aim_at(targets.entities(), targets.pairs());
        aims.push((0, rows.row(0)), seen, |entity| places[entity]);
        Ok(())
    }

    /// Features of an entity: the columns before its last action.
    fn features(&self) -> usize {
        self.network.shape.input - self.network.shape.actions
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
        self.network.shape.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.fill(observation)?;
        let Self { network, tape, input, attention } = self;
        let layers = UtilityLayers::of(network.shape);
        let mut pass = tape.begin(network.parameters);
        let looked = layers.look(&mut pass, input);
        let computed = layers.head(&mut pass, looked, input);
        attention.clear();
        attention.extend(pass.attention_weights(looked.attended).unwrap_or_default());
        let computed = pass.values(computed);
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(computed);
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions()];
        self.utilities(observation, &mut utilities)?;
        masked_argmax(&utilities, observation.available)
    }
}
