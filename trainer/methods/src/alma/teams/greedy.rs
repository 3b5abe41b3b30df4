//! Teams that can be measured, and their agents, which act in many worlds at once: alone, with a memory, or told strategies
//! by a coach.

use sortie_core::entity_mask::EntityMask;
use sortie_core::policy::{DecideError, NO_ACTION as NO_ACTION_YET, Observation, Policy, visible};
use sortie_envs::{ActionSet, Observation as Seen, UNASSIGNED, members};
use sortie_learn::LearnError;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Places, Tape};

use super::{Scene, Team};
use crate::alma::agents::{
    Columns, Conditioning, NO_ACTION, TeamBatch, UtilityLayers, UtilityNetwork, UtilityShape,
    best_action,
};
use crate::alma::coach::{Advice, Coach, strategy_of};

/// Agents that learn or have learned, greedy, on all scenes at once.
#[derive(Debug)]
pub struct NetworkTeam<'a> {
    agents: Agents<'a>,
    players: Players,
    advice: Option<Advice<'a>>,
}

impl<'a> NetworkTeam<'a> {
    /// Acts by a network that sees its subtask only.
    pub fn new(network: &'a UtilityNetwork) -> Self {
        Self::conditioned(Agents::new(network), Conditioning::Mask)
    }

    /// Acts by agents that see subtasks as they were trained to, and are told their strategies if they have a coach.
    pub fn conditioned(agents: Agents<'a>, conditioning: Conditioning) -> Self {
        let players = Players::new(conditioning);
        Self { agents, players, advice: agents.coach.map(Advice::new) }
    }
}

impl Team for NetworkTeam<'_> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        self.players.act(self.agents, scenes, agents, |scene, agent, utilities| {
            let available = scenes[scene].seen.available[agent];
            actions[scene * agents + agent] = best_action(utilities, available).into();
        })
    }

    fn advise(&mut self, seen: &Seen, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        self.advice.as_mut().map_or(Ok(()), |advice| advice.mean(seen, strategies))
    }
}

/// The scripted low level.
#[derive(Debug)]
pub struct ScriptedActors {
    generator: Generator,
}

impl ScriptedActors {
    /// A script that breaks ties by a seed.
    pub fn new(seed: u64) -> Self {
        Self { generator: generator(seed, Purpose::Evaluation, u64::MAX) }
    }
}

impl Team for ScriptedActors {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            let Scene { environment, state, allocation, .. } = *scene;
            if !environment.scripted(state, allocation, &mut self.generator, actions) {
                let name = environment.spec().name;
                return Err(LearnError::Team(format!("`{name}` has no scripted agents")));
            }
        }
        Ok(())
    }
}

/// A deployed policy, agent by agent, on what each of them would see.
#[derive(Debug)]
pub struct PolicyTeam<P> {
    policy: P,
    rows: Vec<f32>,
    last_actions: Vec<u16>,
    entity_task: Vec<u32>,
}

impl<P: Policy> PolicyTeam<P> {
    /// Acts by a policy under the subtask mask.
    pub fn new(policy: P) -> Self {
        Self { policy, rows: Vec::new(), last_actions: Vec::new(), entity_task: Vec::new() }
    }

    fn observe(&mut self, scene: &Scene<'_>, features: usize) {
        let (seen, agents) = (scene.seen, scene.seen.agents());
        seen.rows.write_all(features, &mut self.rows);
        let widen =
            |action: &u8| if *action == NO_ACTION { NO_ACTION_YET } else { (*action).into() };
        self.last_actions.clear();
        self.last_actions.extend(scene.last_actions[..agents].iter().map(widen));
        let task_bit = |task: &u8| 1u32.checked_shl((*task).into()).unwrap_or(0);
        self.entity_task.clear();
        self.entity_task.extend(scene.allocation[..agents].iter().map(task_bit));
        let things = members(seen.present).skip(agents);
        self.entity_task.extend(things.map(|entity| seen.entity_task[entity]));
    }
}

impl<P: Policy> Team for PolicyTeam<P> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            let shape = scene.environment.spec().shape;
            self.observe(scene, shape.features);
            let everything = EntityMask::first(self.entity_task.len());
            let codes = |set: &ActionSet| {
                (0..shape.actions).map(|action| (set >> action & 1) as u16).collect()
            };
            let present = &scene.seen.available[..scene.seen.agents()];
            let available: Vec<Vec<u16>> = present.iter().map(codes).collect();
            let see = |(index, available)| {
                let task = scene.allocation[index];
                let subtask = (task != UNASSIGNED).then_some(task);
                Observation {
                    rows: &self.rows,
                    stride: shape.features,
                    last_actions: &self.last_actions,
                    visible: visible(everything, everything, &self.entity_task, subtask),
                    self_index: index,
                    available,
                }
            };
            let observations: Vec<Observation<'_>> =
                available.iter().map(Vec::as_slice).enumerate().map(see).collect();
            let mut decisions = vec![Err(DecideError::BadLength); observations.len()];
            self.policy.decide_batch(&observations, &mut decisions);
            for (action, decision) in actions.iter_mut().zip(decisions) {
                *action = decision.map_err(|e| LearnError::Team(e.to_string()))?.action;
            }
        }
        Ok(())
    }
}

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
    tape: Tape,
    /// (scene, agent) of every row of the batch.
    actors: Vec<(usize, usize)>,
    /// Of network and memory unit, where there is one.
    parameters: Vec<f32>,
    /// `[worlds, A, R]`: what every agent remembers.
    memory: Vec<f32>,
    /// `[rows, R]`: the same of those who act.
    remembered: Vec<f32>,
}

impl Players {
    /// Buffers for agents that see teams so; nobody remembers anything.
    pub fn new(conditioning: Conditioning) -> Self {
        Self {
            batch: TeamBatch::new(conditioning),
            tape: Tape::default(),
            actors: Vec::new(),
            parameters: Vec::new(),
            memory: Vec::new(),
            remembered: Vec::new(),
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
        let Agents { network, memory_unit, coach } = agents;
        let shape = network.shape();
        self.recall(scenes, slots, shape.base, memory_unit.is_empty());
        let Self { batch, tape, actors, parameters, remembered, .. } = self;
        let mut t = tape.begin(if memory_unit.is_empty() {
            network.parameters()
        } else {
            parameters.clear();
            parameters.extend(network.parameters().iter().chain(memory_unit));
            &parameters[..]
        });
        let places = &mut Places::default();
        let layers = UtilityLayers::of(shape, places);
        let mut base = layers.base(&mut t, batch.input());
        if coach.is_some() {
            let mut told = vec![0.0; actors.len() * shape.base];
            for (told, (scene, agent)) in told.chunks_exact_mut(shape.base).zip(&*actors) {
                if let Some(own) = strategy_of(scenes[*scene].strategies, *agent, shape.base) {
                    told.copy_from_slice(own);
                }
            }
            let told = t.input(shape.base, &told);
            base = t.add(base, told);
        }
        if !memory_unit.is_empty() {
            base = t.gru(base, places.gru(shape.base), &vec![true; actors.len()], remembered);
        }
        let utilities = layers.head(&mut t, base);
        let rows = t.values(utilities).chunks_exact(shape.actions);
        for ((scene, agent), utilities) in actors.iter().zip(rows) {
            each(*scene, *agent, utilities);
        }
        self.keep(scenes, slots, shape.base);
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
        batch.finish();
        Ok(())
    }

    /// Lists what those who act remember, nothing where they have just begun or have no memory at all.
    fn recall(&mut self, scenes: &[Scene<'_>], slots: usize, width: usize, nothing: bool) {
        self.remembered.clear();
        if nothing {
            return;
        }
        for (scene, agent) in self.actors.iter().copied() {
            let place = (scenes[scene].world * slots + agent) * width;
            self.memory.resize(self.memory.len().max(place + width), 0.0);
            let memory = &mut self.memory[place..place + width];
            if scenes[scene].last_actions[agent] == NO_ACTION {
                memory.fill(0.0);
            }
            self.remembered.extend_from_slice(memory);
        }
    }

    /// Writes down what those who act remember now.
    fn keep(&mut self, scenes: &[Scene<'_>], slots: usize, width: usize) {
        for ((scene, agent), after) in self.actors.iter().zip(self.remembered.chunks_exact(width)) {
            let place = (scenes[*scene].world * slots + agent) * width;
            self.memory[place..place + width].copy_from_slice(after);
        }
    }
}
