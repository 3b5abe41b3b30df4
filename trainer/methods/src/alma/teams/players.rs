//! Agents that act in many worlds at once: alone, with a memory, or told strategies by a coach.

use sortie_nn::layers::gru::{GruPass, GruShape};

use super::Scene;
use crate::alma::agents::{
    Columns, Conditioning, NO_ACTION, TeamBatch, UtilityNetwork, UtilityPass, UtilityShape,
};
use crate::alma::coach::{Coach, PlayerPass, strategy_of};
use sortie_learn::LearnError;

/// What agents act by.
#[derive(Clone, Copy, Debug)]
pub struct Agents<'a> {
    /// Their utility network.
    pub network: &'a UtilityNetwork,
    /// The recurrent unit of their memory; empty where they have none.
    pub memory_unit: &'a [f32],
    /// What tells them their strategies at decision points, if anything does (COPA).
    pub coach: Option<&'a Coach>,
}

impl<'a> Agents<'a> {
    /// Agents without memory and coach.
    pub fn new(network: &'a UtilityNetwork) -> Self {
        Self { network, memory_unit: &[], coach: None }
    }
}

/// The buffers to act with, and what agents remember of the running episodes.
#[derive(Debug)]
pub struct Players {
    batch: TeamBatch,
    pass: UtilityPass,
    /// (scene, agent) of every row of the batch.
    actors: Vec<(usize, usize)>,
    advised: PlayerPass,
    gru: GruPass,
    /// `[worlds, A, R]`: what every agent remembers.
    memory: Vec<f32>,
    /// `[rows, R]`: the same of those who act, before and after.
    remembered: Vec<f32>,
    output: Vec<f32>,
}

impl Players {
    /// Buffers for networks of a shape; nobody remembers anything.
    pub fn new(conditioning: Conditioning, shape: UtilityShape) -> Self {
        Self {
            batch: TeamBatch::new(conditioning),
            pass: UtilityPass::new(shape),
            actors: Vec::new(),
            advised: PlayerPass::default(),
            gru: GruPass::default(),
            memory: Vec::new(),
            remembered: Vec::new(),
            output: Vec::new(),
        }
    }

    /// Computes the utilities `[U]` of all agents of all scenes and gives them to `each` with scene and agent.
    ///
    /// A world has `slots` agents at most. Who has not acted yet in its episode remembers nothing.
    ///
    /// # Errors
    /// The network marks fewer subtasks than a scene has.
    pub fn act(
        &mut self,
        agents: Agents<'_>,
        scenes: &[Scene<'_>],
        slots: usize,
        mut each: impl FnMut(usize, usize, &[f32]),
    ) -> Result<(), LearnError> {
        self.look(agents.network.shape(), scenes)?;
        let Self { batch, pass, advised, actors, .. } = self;
        let (network, input) = (agents.network, batch.finish());
        let utilities = if agents.coach.is_some() {
            let width = network.shape().base;
            let told = actors
                .iter()
                .map(|(scene, agent)| strategy_of(scenes[*scene].strategies, *agent, width));
            advised.forward(network, pass, input, told)
        } else if agents.memory_unit.is_empty() {
            pass.forward(network, input)
        } else {
            let base = pass.forward_base(network, input).to_vec();
            self.remember(agents, &base, scenes, slots);
            self.pass.forward_head(network, &self.output)
        };
        let actions = agents.network.shape().actions;
        for ((scene, agent), utilities) in self.actors.iter().zip(utilities.chunks_exact(actions)) {
            each(*scene, *agent, utilities);
        }
        Ok(())
    }

    /// Writes what all agents see.
    fn look(&mut self, shape: UtilityShape, scenes: &[Scene<'_>]) -> Result<(), LearnError> {
        let Self { batch, actors, .. } = self;
        let spec = scenes.first().map(|scene| scene.environment.spec());
        batch.clear(spec.map_or_else(Columns::default, |spec| Columns::of(&spec.shape)));
        actors.clear();
        let tasks = scenes.iter().map(|scene| scene.seen.tasks()).max().unwrap_or(0);
        if batch.columns(tasks) > shape.input {
            let reason = format!("the network marks fewer subtasks than the {tasks} of this state");
            return Err(LearnError::Config(reason));
        }
        for (place, scene) in scenes.iter().enumerate() {
            let added = |agent| actors.push((place, agent));
            batch.push_teams(scene.seen, scene.allocation, scene.last_actions, added);
        }
        for (place, scene) in scenes.iter().enumerate() {
            let added = |agent| actors.push((place, agent));
            batch.push_unassigned(scene.seen, scene.allocation, scene.last_actions, added);
        }
        Ok(())
    }

    /// Takes the memories of all who act one step on, from `base [rows, R]`.
    fn remember(&mut self, agents: Agents<'_>, base: &[f32], scenes: &[Scene<'_>], slots: usize) {
        let width = agents.network.shape().base;
        let rows = self.actors.len();
        let place = |(scene, agent): (usize, usize)| (scenes[scene].world * slots + agent) * width;
        let end = self.actors.iter().map(|actor| place(*actor) + width).max().unwrap_or(0);
        self.memory.resize(self.memory.len().max(end), 0.0);
        self.remembered.clear();
        for (scene, agent) in self.actors.iter().copied() {
            let memory = &mut self.memory[place((scene, agent))..][..width];
            if scenes[scene].last_actions[agent] == NO_ACTION {
                memory.fill(0.0);
            }
            self.remembered.extend_from_slice(memory);
        }
        self.output.clear();
        self.output.resize(rows * width, 0.0);
        let shape = GruShape { width, slots: rows };
        let input = (base, &*vec![true; rows]);
        let Self { remembered, output, .. } = self;
        self.gru.forward(shape, agents.memory_unit, input, remembered, output);
        for (actor, after) in self.actors.iter().zip(self.remembered.chunks_exact(width)) {
            self.memory[place(*actor)..][..width].copy_from_slice(after);
        }
    }
}
