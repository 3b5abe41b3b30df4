//! Acting while learning: episodes in many instances, explored, cut into records.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{
    ACTIONS, AgentState, AllocationRule, BuildingState, DecisionPoints, SaveTheCity, ScenarioSet,
    UNASSIGNED,
};
use sortie_envs::{Environment, StepOutcome, Subtasks};

use rand_core::Rng;

use super::conditioning::Conditioning;
use super::config::{AllocationConfig, Config};
use super::history::{History, Moment, StepRewards};
use super::replay::Replay;
use super::team_batch::{NO_ACTION, TeamBatch, best_action};
use super::utility::{UtilityNetwork, UtilityShape};
use super::utility_pass::UtilityPass;
use crate::error::LearnError;
use crate::random::{Generator, Purpose, below, chance, generator, unit};

/// What an instance remembers between steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Instance {
    /// Draws episodes, collisions, allocations and exploration of this instance.
    generator: Generator,
    rule: AllocationRule,
    decisions: DecisionPoints,
    tasks_changed: bool,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    history: History,
    episode_return: f64,
}

/// A running episode as a checkpoint holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InstanceSnapshot {
    instance: Instance,
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
    steps: u32,
}

/// Episodes that ended during some steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeCounts {
    /// Episodes that ended.
    pub episodes: u64,
    /// Those with all buildings complete.
    pub solved: u64,
    /// Those that timed out.
    pub timed_out: u64,
    /// Sum of the team's rewards.
    pub return_sum: f64,
}

/// The instances of a run and the buffers to act in them.
#[derive(Debug)]
pub struct Rollout {
    city: SaveTheCity,
    instances: Vec<Instance>,
    allocation: AllocationConfig,
    spread: Vec<f32>,
    batch: TeamBatch,
    pass: UtilityPass,
    /// (instance, agent) of every row of the batch.
    actors: Vec<(usize, usize)>,
    /// `[instances, A]`
    actions: Vec<u16>,
}

impl Rollout {
    /// Starts an episode in every instance.
    pub fn new(config: &Config, shape: UtilityShape, seed: u64) -> Result<Self, LearnError> {
        let set = ScenarioSet::named(&config.environment.set)?;
        let count = config.environment.instances;
        let agents = set.max_agents;
        let city = SaveTheCity::new(set, config.environment.constants, count, 0)?;
        let instances = (0..count).map(|index| Instance {
            generator: generator(seed, Purpose::Rollout, index as u64),
            rule: AllocationRule::Coordinated,
            decisions: DecisionPoints::every(config.allocation.interval),
            tasks_changed: false,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            history: History::new(Conditioning::Mask, (&config.returns).into()),
            episode_return: 0.0,
        });
        let mut rollout = Self {
            instances: instances.collect(),
            city,
            allocation: config.allocation.clone(),
            spread: config.exploration.spread.clone(),
            batch: TeamBatch::default(),
            pass: UtilityPass::new(shape),
            actors: Vec::new(),
            actions: vec![0; count * agents],
        };
        for index in 0..count {
            rollout.restart(index);
        }
        Ok(rollout)
    }

    /// Number of instances: environment steps that one [`step`](Self::step) takes.
    pub fn instances(&self) -> usize {
        self.instances.len()
    }

    /// Takes one step in every instance and stores the records that it completes.
    pub fn step(
        &mut self,
        network: &UtilityNetwork,
        epsilon: f32,
        replay: &mut Replay,
        counts: &mut EpisodeCounts,
    ) -> Result<(), LearnError> {
        for (index, instance) in self.instances.iter_mut().enumerate() {
            let city = self.city.city(index);
            if instance.decisions.is_due(instance.tasks_changed) {
                let Instance { rule, generator, allocation, .. } = instance;
                rule.allocate(city, generator, allocation);
            }
            let Instance { history, allocation, last_actions, .. } = instance;
            history.decide(Moment { city, allocation, last_actions }, replay);
        }
        self.choose(network, epsilon);
        for index in 0..self.instances.len() {
            self.advance(index, replay, counts)?;
        }
        Ok(())
    }

    /// Writes the actions of all agents: the best by the network, or a random one.
    fn choose(&mut self, network: &UtilityNetwork, epsilon: f32) {
        self.batch.clear();
        self.actors.clear();
        // An agent without a building stays.
        self.actions.fill(0);
        for (index, instance) in self.instances.iter().enumerate() {
            let city = self.city.city(index);
            let Instance { allocation, last_actions, .. } = instance;
            self.batch.push_teams(city, allocation, last_actions, |agent| {
                self.actors.push((index, agent));
            });
        }
        let input = self.batch.finish();
        let utilities = self.pass.forward(network, input);
        let agents = self.city.shape().agents;
        for ((index, agent), utilities) in self.actors.iter().zip(utilities.chunks_exact(ACTIONS)) {
            let available = self.city.city(*index).agents[*agent].available;
            let instance = &mut self.instances[*index];
            let explore = epsilon * self.spread[index % self.spread.len()];
            let action = if chance(&mut instance.generator, explore.into()) {
                random_action(available, &mut instance.generator)
            } else {
                best_action(utilities, available)
            };
            self.actions[index * agents + agent] = action.into();
        }
    }

    fn advance(
        &mut self,
        index: usize,
        replay: &mut Replay,
        counts: &mut EpisodeCounts,
    ) -> Result<(), LearnError> {
        let instance = &mut self.instances[index];
        let agents = self.city.shape().agents;
        let actions = &self.actions[index * agents..][..agents];
        let Instance { history, allocation, last_actions, generator, .. } = instance;
        history.act(Moment { city: self.city.city(index), allocation, last_actions }, actions);

        let outcome = self.city.step_with_losers(index, actions, |first, second| {
            if below(generator, 2) == 0 { first } else { second }
        })?;
        for (last, action) in last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        let after = Moment { city: self.city.city(index), allocation, last_actions };
        let rewards = StepRewards { tasks: self.city.task_rewards(index), team: outcome.reward };
        history.reward(after, rewards, replay);
        instance.tasks_changed = outcome.tasks_changed;
        instance.episode_return += outcome.reward;
        if outcome.done() {
            instance.history.end(after, outcome.timed_out, replay);
            self.count(index, outcome, counts);
            self.restart(index);
        }
        Ok(())
    }

    fn count(&self, index: usize, outcome: StepOutcome, counts: &mut EpisodeCounts) {
        counts.episodes += 1;
        counts.solved += u64::from(self.city.metrics(index).solved);
        counts.timed_out += u64::from(outcome.timed_out);
        counts.return_sum += self.instances[index].episode_return;
    }

    fn restart(&mut self, index: usize) {
        let instance = &mut self.instances[index];
        instance.rule = draw_rule(&self.allocation, &mut instance.generator);
        instance.decisions.restart();
        instance.tasks_changed = false;
        instance.last_actions.fill(NO_ACTION);
        instance.episode_return = 0.0;
        self.city.seed(index, instance.generator.next_u64());
        self.city.reset(index);
    }

    /// Everything that the instances need to go on exactly as they would have.
    pub fn snapshot(&self) -> Vec<InstanceSnapshot> {
        let instances = self.instances.iter().enumerate();
        instances
            .map(|(index, instance)| InstanceSnapshot {
                instance: instance.clone(),
                agents: self.city.city(index).agents.to_vec(),
                buildings: self.city.city(index).buildings.to_vec(),
                steps: self.city.metrics(index).steps,
            })
            .collect()
    }

    /// Continues from a snapshot of as many instances.
    pub fn restore(&mut self, snapshots: Vec<InstanceSnapshot>) -> Result<(), LearnError> {
        let agents = self.city.shape().agents;
        let fits = |s: &InstanceSnapshot| {
            s.instance.allocation.len() == agents && s.instance.last_actions.len() == agents
        };
        if snapshots.len() != self.instances.len() || !snapshots.iter().all(fits) {
            return Err(LearnError::Config("the checkpoint has other instances".to_owned()));
        }
        for (index, snapshot) in snapshots.into_iter().enumerate() {
            let InstanceSnapshot { instance, agents, buildings, steps } = snapshot;
            self.city.restore(index, &agents, &buildings, steps)?;
            self.instances[index] = instance;
        }
        Ok(())
    }
}

/// A uniform choice among the available actions.
fn random_action(available: u16, generator: &mut Generator) -> u8 {
    let chosen = below(generator, available.count_ones() as usize);
    (0..16).filter(|action| available >> action & 1 == 1).nth(chosen).unwrap_or(0)
}

/// A rule, drawn by its weight.
fn draw_rule(config: &AllocationConfig, generator: &mut Generator) -> AllocationRule {
    let weights = config.weights();
    let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
    let mut left = unit(generator) * total;
    for (rule, weight) in weights {
        left -= weight;
        if left < 0.0 {
            return rule;
        }
    }
    AllocationRule::Coordinated
}
