//! Agents that act: greedy, or with chance.

use sortie_envs::random::{chance, member};
use sortie_envs::{EntitySet, Observation, Random};

use super::agent::AgentPass;
use super::scenes::Scenes;
use super::temporal_difference::{Network, best};

/// Buffers for the decisions of any number of teams at once.
#[derive(Clone, Debug, Default)]
pub struct Acting {
    scenes: Scenes,
    slots: usize,
    pass: AgentPass,
}

impl Acting {
    /// Forgets all teams.
    pub fn clear(&mut self) {
        self.scenes.clear();
    }

    /// Adds a team.
    pub fn push(&mut self, seen: &Observation) {
        self.slots = seen.observable.len();
        self.scenes.push(seen, |_| EntitySet::MAX);
    }

    /// Writes for every team the best actions of its agents, 0 for those that do not exist; each is
    /// replaced by a random one with the chance of its team.
    pub fn act(
        &mut self,
        network: &Network,
        chances: impl Iterator<Item = f32>,
        random: &mut Random,
        actions: &mut Vec<u16>,
    ) {
        self.scenes.finish();
        let shape = network.shape.agent;
        let utilities = self.pass.forward(shape, network.agent(), &self.scenes, 1);
        let mut agents = utilities.chunks_exact(shape.actions).zip(self.scenes.available());
        actions.clear();
        for (size, probability) in self.scenes.sizes().iter().zip(chances) {
            let end = actions.len() + self.slots;
            for (utilities, available) in agents.by_ref().take(*size) {
                let action = if chance(random, probability.into()) {
                    member(random, (*available).into()).unwrap_or(0)
                } else {
                    best(utilities, *available)
                };
                actions.push(action as u16);
            }
            actions.resize(end, 0);
        }
    }
}
