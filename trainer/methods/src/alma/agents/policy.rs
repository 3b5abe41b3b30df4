//! The network in training as a policy, agent by agent, as deployment asks for it.

use sortie_core::{DecideError, Observation, Policy};
use sortie_learn::networks::{OwnPass, OwnView};
use sortie_nn::tape::Tape;

use super::layers::UtilityLayers;
use super::utility::{UtilityShape, UtilityView};

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
#[derive(Debug)]
pub struct NetworkPolicy<'a> {
    network: UtilityView<'a>,
    tape: Tape,
    own: OwnView,
    /// What the last answer attended to, `[entities, heads]`.
    attention: Vec<f32>,
}

impl<'a> NetworkPolicy<'a> {
    /// Decides with a network.
    pub fn new(network: UtilityView<'a>) -> Self {
        let (tape, own) = (Tape::default(), OwnView::default());
        Self { network, tape, own, attention: Vec::new() }
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

    /// The utilities `[U]` of an agent's actions.
    ///
    /// # Errors
    /// It is shown too few features.
    pub fn utilities(&mut self, observation: &Observation<'_>) -> Result<Vec<f32>, DecideError> {
        let Self { network, tape, own, attention } = self;
        let UtilityShape { input, actions, targets, .. } = network.shape;
        own.look(observation, [input - actions, actions], targets)?;
        let (layers, view) = (UtilityLayers::of(network.shape), own.batch.seen());
        let mut pass = tape.begin(network.parameters);
        let looked = layers.look(&mut pass, view);
        let utilities = layers.head(&mut pass, looked, own.batch.aims(view));
        attention.clear();
        attention.extend(pass.attention_weights(looked.attended.output).unwrap_or_default());
        Ok(pass.values(utilities).to_vec())
    }

    /// The same as a policy.
    pub fn deployed(mut self) -> impl Policy + use<'a> {
        let actions = self.network.shape.actions;
        let utilities = move |seen: &Observation<'_>, _: &mut [f32]| self.utilities(seen);
        OwnPass { actions, memory: 0, utilities }
    }
}
