//! Agents as they are deployed, and beside them the trainer's own forward pass.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, NO_ACTION, Observation, Policy};
use sortie_envs::EntitySet;
use sortie_nn::tape::Tape;

use super::agent::{AgentShape, EntityAgent};
use super::aims::Targets;
use super::batch::EntityBatch;
use crate::export::{DeployedAgents, DeployedNetworks};

/// The agents as they are deployed.
pub fn deployed<'a>(agents: &'a EntityAgent, weights: &'a [f32]) -> DeployedAgents<'a> {
    let (network, memory) = agents.deployed(weights);
    let networks = DeployedNetworks::Attention { network, memory };
    let AgentShape { looking, actions, memory, targets, .. } = agents.shape;
    let (mut tape, mut own) = (Tape::default(), OwnView::default());
    let utilities = move |seen: &Observation<'_>, hidden: &mut [f32]| {
        own.look(seen, [looking.input, 0], targets)?;
        let mut pass = tape.begin_forward(weights);
        let utilities = agents.utilities(&mut pass, &own.batch, own.batch.seen(), hidden);
        Ok(pass.values(utilities).to_vec())
    };
    DeployedAgents { networks, policy: Box::new(OwnPass { actions, memory, utilities }) }
}

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
#[derive(Debug)]
pub struct OwnPass<F> {
    /// Actions U.
    pub actions: usize,
    /// Floats of what an agent remembers.
    pub memory: usize,
    /// The utilities `[U]` of what an agent sees, who remembers so much before and then.
    pub utilities: F,
}

impl<F> Policy for OwnPass<F>
where
    F: FnMut(&Observation<'_>, &mut [f32]) -> Result<Vec<f32>, DecideError>,
{
    fn actions(&self) -> usize {
        self.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.utilities_with(observation, &mut [], utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn hidden(&self) -> usize {
        self.memory
    }

    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let (want, got) = (self.memory, hidden.len());
        if got != want {
            return Err(DecideError::HiddenState { want, got });
        }
        let computed = (self.utilities)(observation, hidden)?;
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(&computed);
        Ok(())
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions];
        self.utilities_with(observation, hidden, &mut utilities)?;
        masked_argmax(&utilities, observation.available)
    }
}

/// What one agent sees, as networks are shown it.
#[derive(Debug, Default)]
pub struct OwnView {
    /// The agent is its first entity and its only agent; what it sees follows.
    pub batch: EntityBatch,
    seen: sortie_envs::Observation,
    /// Entities in the order in which they are looked at.
    order: Vec<usize>,
}

/// The number of an entity that is not seen: the last that there can be, which no order reaches that lacks one.
const UNSEEN: usize = EntitySet::BITS as usize - 1;

impl OwnView {
    /// Looks at what an agent sees, by rows of so many features, and behind them the last of so many actions as zeros and a
    /// one, for a head that points at these targets.
    ///
    /// # Errors
    /// There are fewer features.
    pub fn look(
        &mut self,
        observation: &Observation<'_>,
        [features, actions]: [usize; 2],
        targets: Targets,
    ) -> Result<(), DecideError> {
        let Self { batch, seen, order } = self;
        let own = observation.self_index;
        let others = observation.visible.iter().filter(|entity| *entity != own);
        seen.rows.clear();
        order.clear();
        order.extend(std::iter::once(own).chain(others));
        for entity in order.iter().copied() {
            let row = observation.rows.get(entity * observation.stride..);
            let row = row.and_then(|row| row.get(..features)).ok_or(DecideError::BadLength)?;
            let told = row.iter().enumerate().filter(|(_, value)| **value != 0.0);
            told.for_each(|(column, value)| seen.rows.push(column, *value));
            let last = observation.last_actions.get(entity).filter(|last| **last != NO_ACTION);
            if let Some(action) = last.map(|last| usize::from(*last)).filter(|it| *it < actions) {
                seen.rows.push(features + action, 1.0);
            }
            seen.rows.end_row();
        }
        let all = EntitySet::MAX >> (EntitySet::BITS as usize - order.len());
        (seen.present, seen.entities) = (all, all);
        seen.available.resize(1, 0);
        seen.observable.clear();
        seen.observable.push(if observation.visible.contains(own) { all } else { all & !1 });
        batch.clear();
        batch.push(seen);
        // Who is not seen has no number here, and is beyond all that have.
        let place = |entity| order.iter().position(|it| *it == entity).unwrap_or(UNSEEN);
        batch.aim_at(targets.entities().map(place), targets.pairs());
        batch.finish(false);
        Ok(())
    }
}
