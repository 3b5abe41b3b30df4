//! Agents that act: greedy, or with chance.

use sortie_envs::random::{chance, member};
use sortie_envs::{ActionSet, EntitySet, Observation, Random};

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

    /// Writes for every team the best actions of its agents.
    pub fn choose(&mut self, network: &Network, actions: &mut [u16]) {
        self.decide(network, actions, |_, best, _| best);
    }

    /// The same, each replaced by a random one with the chance of its team.
    pub fn act(
        &mut self,
        network: &Network,
        chances: impl Iterator<Item = f32>,
        random: &mut Random,
        actions: &mut [u16],
    ) {
        let chances: Vec<f32> = chances.collect();
        self.decide(network, actions, |team, best, available| {
            if chance(random, chances[team].into()) {
                member(random, available.into()).unwrap_or(best)
            } else {
                best
            }
        });
    }

    fn decide(
        &mut self,
        network: &Network,
        actions: &mut [u16],
        mut choose: impl FnMut(usize, usize, ActionSet) -> usize,
    ) {
        self.scenes.finish();
        let shape = network.shape.agent;
        let utilities = self.pass.forward(shape, network.agent(), &self.scenes, 1);
        let mut agents = utilities.chunks_exact(shape.actions).zip(self.scenes.available());
        let teams = self.scenes.sizes().iter().zip(actions.chunks_exact_mut(self.slots.max(1)));
        for (team, (size, actions)) in teams.enumerate() {
            for (action, (utilities, available)) in
                actions.iter_mut().zip(agents.by_ref().take(*size))
            {
                *action = choose(team, best(utilities, *available), *available) as u16;
            }
        }
    }
}
