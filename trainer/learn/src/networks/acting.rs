//! Agents that act: greedy, or with chance.

use std::collections::BTreeMap;

use sortie_envs::random::{chance, member, unit};
use sortie_envs::{ActionSet, EntitySet, Observation, Random, members};
use sortie_nn::layers::softmax;
use sortie_nn::tape::Tape;

use super::agent::EntityAgent;
use super::batch::EntityBatch;
use crate::act::{Act, Ask, Scenes};
use crate::error::Result;

/// The available action of the highest utility, the first of several.
pub fn best(utilities: &[f32], available: ActionSet) -> usize {
    let mut best = available.trailing_zeros() as usize;
    for action in members(available) {
        if utilities[action] > utilities[best] {
            best = action;
        }
    }
    best
}

/// The softmax of the scores of those actions that are available; 0 for all others.
pub fn chances(scores: &[f32], available: ActionSet) -> Vec<f32> {
    let mut chances = vec![f32::NEG_INFINITY; scores.len()];
    for action in members(available) {
        chances[action] = scores[action];
    }
    softmax::forward(&mut chances);
    chances
}

/// Draws an available action by its [chance](chances).
pub fn draw(scores: &[f32], available: ActionSet, random: &mut Random) -> usize {
    drawn(&chances(scores, available), unit(random) as f32)
}

/// The action whose share of 0..1 a number falls into.
pub fn drawn(chances: &[f32], mut number: f32) -> usize {
    for (action, chance) in chances.iter().enumerate() {
        if number < *chance {
            return action;
        }
        number -= chance;
    }
    (0..chances.len()).rev().find(|action| chances[*action] > 0.0).unwrap_or(0)
}

/// Buffers for the decisions of any number of teams at once, and what their agents remember.
#[derive(Debug, Default)]
pub struct Acting {
    batch: EntityBatch,
    /// Agents of a team.
    slots: usize,
    /// The slots of those that act, team by team.
    acting: Vec<usize>,
    /// `[teams, A]`: the first action that is available to each.
    available: Vec<u16>,
    tape: Tape,
    seen: Observation,
    /// Who acts, and whether its episode begins.
    instances: Vec<(usize, bool)>,
    /// `[teams, A, memory]`
    memory: Vec<f32>,
    /// Of every instance `[A, memory]`; empty where agents remember nothing.
    pub memories: BTreeMap<usize, Vec<f32>>,
}

impl Acting {
    /// Looks at scenes in the place of those before; what agents remember stays.
    pub fn look(&mut self, scenes: &Scenes<'_>) {
        self.clear();
        let mut seen = std::mem::take(&mut self.seen);
        for scene in scenes.scenes {
            scenes.environment.observe(scene.state, 0, EntitySet::MAX, &mut seen);
            self.push(scene.instance, scene.begins, &seen);
        }
        self.seen = seen;
    }

    /// Forgets all teams, but not what they remember.
    pub fn clear(&mut self) {
        self.batch.clear();
        self.instances.clear();
        self.acting.clear();
        self.available.clear();
    }

    /// Adds the team of an instance.
    pub fn push(&mut self, instance: usize, begins: bool, seen: &Observation) {
        self.slots = seen.observable.len();
        self.acting.extend(members(seen.acting().into()));
        self.available.extend(seen.available.iter().map(|open| open.trailing_zeros() as u16));
        self.instances.push((instance, begins));
        self.batch.push(seen);
    }

    /// Writes for every team the best actions of its agents.
    pub fn choose(&mut self, agents: &EntityAgent, weights: &[f32], actions: &mut [u16]) {
        self.decide((agents, weights), actions, |_, best, _| best);
    }

    /// The same, each replaced by a random one with the chance and by the generator of its team.
    pub fn explore<'a>(
        &mut self,
        network: (&EntityAgent, &[f32]),
        teams: impl Iterator<Item = (f32, &'a mut Random)>,
        actions: &mut [u16],
    ) {
        let mut teams: Vec<_> = teams.collect();
        self.decide(network, actions, |team, best, available| {
            let (epsilon, random) = &mut teams[team];
            if chance(random, (*epsilon).into()) {
                member(random, available).unwrap_or(best)
            } else {
                best
            }
        });
    }

    fn decide(
        &mut self,
        (agents, weights): (&EntityAgent, &[f32]),
        actions: &mut [u16],
        mut choose: impl FnMut(usize, usize, ActionSet) -> usize,
    ) {
        let shape = agents.shape;
        self.batch.aim_at(shape.targets.entities(), shape.targets.pairs());
        self.batch.finish(false);
        self.recall(shape.memory);
        let Self { batch, tape, memory, .. } = self;
        let mut pass = tape.begin_forward(weights);
        let utilities = agents.utilities(&mut pass, batch, batch.seen(), memory);
        let rows = pass.values(utilities).chunks_exact(shape.actions);
        let mut agents = rows.zip(batch.available()).zip(&self.acting);
        // Who does not act has nothing to choose from.
        actions[..self.available.len()].copy_from_slice(&self.available);
        let teams = batch.sizes().iter().zip(actions.chunks_exact_mut(self.slots.max(1)));
        for (team, (size, actions)) in teams.enumerate() {
            for ((utilities, available), agent) in agents.by_ref().take(*size) {
                actions[*agent] = choose(team, best(utilities, *available), *available) as u16;
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

    fn keep(&mut self, width: usize) {
        let memories = self.memory.chunks_exact((self.slots * width).max(1));
        for ((instance, _), memory) in self.instances.iter().zip(memories) {
            self.memories.insert(*instance, memory.to_vec());
        }
    }
}

/// Agents that take the best action that they know.
#[derive(Debug)]
pub struct Greedy<'a> {
    agents: &'a EntityAgent,
    weights: &'a [f32],
    acting: Acting,
}

impl<'a> Greedy<'a> {
    /// They act by these weights, and remember nothing yet.
    pub fn new(agents: &'a EntityAgent, weights: &'a [f32]) -> Self {
        Self { agents, weights, acting: Acting::default() }
    }
}

impl Act for Greedy<'_> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<()> {
        self.acting.look(scenes);
        self.acting.choose(self.agents, self.weights, actions);
        Ok(())
    }
}
