//! Agents that act: greedy, or with chance.

use std::collections::BTreeMap;

use sortie_envs::random::{chance, member};
use sortie_envs::{ActionSet, EntitySet, Observation, Random};

use super::agent::AgentPass;
use super::scenes::Scenes;
use super::temporal_difference::{Network, best};

/// Buffers for the decisions of any number of teams at once, and what their agents remember.
#[derive(Clone, Debug, Default)]
pub struct Acting {
    scenes: Scenes,
    slots: usize,
    pass: AgentPass,
    /// Who acts, and whether its episode begins.
    instances: Vec<(usize, bool)>,
    /// `[teams, A, memory]`
    memory: Vec<f32>,
    /// Of every instance `[A, memory]`; empty where agents remember nothing.
    pub(super) memories: BTreeMap<usize, Vec<f32>>,
}

impl Acting {
    /// Forgets all teams, but not what they remember.
    pub fn clear(&mut self) {
        self.scenes.clear();
        self.instances.clear();
    }

    /// Adds the team of an instance.
    pub fn push(&mut self, instance: usize, begins: bool, seen: &Observation) {
        self.slots = seen.observable.len();
        self.instances.push((instance, begins));
        self.scenes.push(seen, |_| EntitySet::MAX);
    }

    /// Writes for every team the best actions of its agents.
    pub fn choose(&mut self, network: &Network, actions: &mut [u16]) {
        self.decide(network, actions, |_, best, _| best);
    }

    /// The same, each replaced by a random one with the chance and by the generator of its team.
    pub fn act<'a>(
        &mut self,
        network: &Network,
        teams: impl Iterator<Item = (f32, &'a mut Random)>,
        actions: &mut [u16],
    ) {
        let mut teams: Vec<_> = teams.collect();
        self.decide(network, actions, |team, best, available| {
            let (epsilon, random) = &mut teams[team];
            if chance(random, (*epsilon).into()) {
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
        self.recall(shape.memory);
        let memory = (shape.memory > 0).then_some(&mut *self.memory);
        let scenes = (&self.scenes, 1);
        let utilities = self.pass.forward_from(shape, network.agent(), scenes, memory);
        let mut agents = utilities.chunks_exact(shape.actions).zip(self.scenes.available());
        let teams = self.scenes.sizes().iter().zip(actions.chunks_exact_mut(self.slots.max(1)));
        for (team, (size, actions)) in teams.enumerate() {
            for (action, (utilities, available)) in
                actions.iter_mut().zip(agents.by_ref().take(*size))
            {
                *action = choose(team, best(utilities, *available), *available) as u16;
            }
        }
        self.keep(shape.memory);
    }

    /// What every team remembers: nothing where its episode begins.
    fn recall(&mut self, width: usize) {
        let team = self.slots * width;
        self.memory.clear();
        self.memory.resize(self.instances.len() * team, 0.0);
        for (place, (instance, begins)) in self.instances.iter().enumerate() {
            if let Some(memory) = self.memories.get(instance).filter(|_| !begins) {
                self.memory[place * team..][..team].copy_from_slice(memory);
            }
        }
    }

    /// Keeps what every team remembers now.
    fn keep(&mut self, width: usize) {
        let memories = self.memory.chunks_exact((self.slots * width).max(1));
        for ((instance, _), memory) in self.instances.iter().zip(memories) {
            self.memories.insert(*instance, memory.to_vec());
        }
    }
}
