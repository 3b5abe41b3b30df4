//! Acting while learning: episodes in many instances, explored, cut into records.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{ACTIONS, AgentState, BuildingState, SaveTheCity, ScenarioSet};
use sortie_envs::{Environment, Step};

use rand_core::Rng;
use sortie_envs::random::chance;
use sortie_nn::random::Generator;

use super::config::Config;
use super::deciding::{Deciding, Decisions};
use super::history::{History, Moment, StepRewards};
use super::replay::Replay;
use super::team_batch::{NO_ACTION, TeamBatch, best_action, random_action};
use super::team_value::Segments;
use super::utility::{UtilityNetwork, UtilityShape};
use super::utility_pass::UtilityPass;
use sortie_learn::LearnError;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;

/// What an instance remembers between steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Instance {
    /// Draws episodes, collisions, allocations and exploration of this instance.
    generator: Generator,
    decisions: Decisions,
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

/// Who acts and allocates in a step.
#[derive(Clone, Copy, Debug)]
pub struct Behaviour<'a> {
    /// The agents' utility network.
    pub agents: &'a UtilityNetwork,
    /// How often agents act at random, before the instances' factors.
    pub epsilon: f32,
    /// The team-value network; without one, rules decide in its stead.
    pub allocator: Option<&'a UtilityNetwork>,
}

/// What keeps the experience of a step.
#[derive(Debug)]
pub struct Memory<'a> {
    /// Records of the agents.
    pub records: &'a mut Replay,
    /// Segments of the allocator, if it learns.
    pub segments: Option<&'a mut Segments>,
}

/// The instances of a run and the buffers to act in them.
#[derive(Debug)]
pub struct Rollout {
    city: SaveTheCity,
    instances: Vec<Instance>,
    deciding: Deciding,
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
        let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
        let count = config.environment.instances;
        let agents = set.max_agents;
        let city = SaveTheCity::new(set, config.environment.constants, count, 0)
            .map_err(LearnError::environment)?;
        let instances = (0..count).map(|index| Instance {
            generator: generator(seed, Purpose::Rollout, index as u64),
            decisions: Decisions::new(config.allocation.interval, agents),
            last_actions: vec![NO_ACTION; agents],
            history: History::new(config.network.subtask, (&config.returns).into()),
            episode_return: 0.0,
        });
        let mut rollout = Self {
            instances: instances.collect(),
            city,
            deciding: Deciding::new(config),
            spread: config.exploration.spread.clone(),
            batch: TeamBatch::new(config.network.subtask),
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

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations() + self.deciding.operations()
    }

    /// Takes one step in every instance and stores the records and segments that it completes.
    pub fn step(
        &mut self,
        behaviour: Behaviour<'_>,
        mut memory: Memory<'_>,
        counts: &mut EpisodeCounts,
    ) -> Result<(), LearnError> {
        for (index, instance) in self.instances.iter_mut().enumerate() {
            let city = self.city.city(index);
            let Instance { decisions, generator, history, last_actions, .. } = instance;
            let segments = memory.segments.as_deref_mut();
            let decided =
                self.deciding.decide(decisions, city, generator, behaviour.allocator, segments)?;
            counts.decisions += u64::from(decided);
            let allocation = &decisions.allocation;
            history.decide(Moment { city, allocation, last_actions }, memory.records);
        }
        self.choose(behaviour.agents, behaviour.epsilon);
        for index in 0..self.instances.len() {
            self.advance(index, &mut memory, counts)?;
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
            let Instance { decisions, last_actions, .. } = instance;
            self.batch.push_teams(city, &decisions.allocation, last_actions, |agent| {
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
        memory: &mut Memory<'_>,
        counts: &mut EpisodeCounts,
    ) -> Result<(), LearnError> {
        let instance = &mut self.instances[index];
        let agents = self.city.shape().agents;
        let actions = &self.actions[index * agents..][..agents];
        let Instance { history, decisions, last_actions, generator, .. } = instance;
        let allocation = &decisions.allocation;
        history.act(Moment { city: self.city.city(index), allocation, last_actions }, actions);

        let outcome = self.city.step(index, actions, generator)?;
        for (last, action) in last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        let after = Moment { city: self.city.city(index), allocation, last_actions };
        let task_rewards = self.city.task_rewards(index);
        let rewards = StepRewards { tasks: task_rewards, team: outcome.reward };
        history.reward(after, rewards, memory.records);
        instance.episode_return += outcome.reward;
        if outcome.done() {
            history.end(after, outcome.timed_out, memory.records);
        }
        decisions.reward(self.deciding.discount(), task_rewards, outcome.tasks_changed);
        if outcome.done() {
            decisions.end(outcome.timed_out, memory.segments.as_deref_mut());
            self.count(index, outcome, counts);
            self.restart(index);
        }
        Ok(())
    }

    fn count(&self, index: usize, outcome: Step, counts: &mut EpisodeCounts) {
        counts.episodes += 1;
        counts.solved += u64::from(self.city.metrics(index).solved);
        counts.timed_out += u64::from(outcome.timed_out);
        counts.return_sum += self.instances[index].episode_return;
    }

    fn restart(&mut self, index: usize) {
        let instance = &mut self.instances[index];
        instance.decisions.restart(self.deciding.allocation(), &mut instance.generator);
        instance.last_actions.fill(NO_ACTION);
        instance.episode_return = 0.0;
        let mut random = sortie_envs::random::generator(instance.generator.next_u64());
        self.city.reset(index, &mut random);
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
            s.instance.decisions.allocation.len() == agents
                && s.instance.last_actions.len() == agents
        };
        if snapshots.len() != self.instances.len() || !snapshots.iter().all(fits) {
            return Err(LearnError::Config("the checkpoint has other instances".to_owned()));
        }
        for (index, snapshot) in snapshots.into_iter().enumerate() {
            let InstanceSnapshot { instance, agents, buildings, steps } = snapshot;
            self.city
                .restore(index, &agents, &buildings, steps)
                .map_err(LearnError::environment)?;
            self.instances[index] = instance;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::RecordLayout;
    use crate::alma::records::team_value::Decision;

    fn config(episode_limit: u32) -> Config {
        let mut config = Config::default();
        config.environment.constants.episode_limit = episode_limit;
        config.environment.instances = 3;
        config.allocator.network.width = 8;
        config
    }

    /// Steps with greedy, untrained agents; an allocator decides from step `decides` on.
    fn play(
        rollout: &mut Rollout,
        steps: usize,
        decides: usize,
        segments: &mut Segments,
    ) -> EpisodeCounts {
        let network =
            |shape| UtilityNetwork::initialise(shape, 8.0, &mut generator(1, Purpose::Weights, 0));
        let config = config(1);
        let (agents, allocator) =
            (network(config.agent_shape().unwrap()), network(config.allocator.shape()));
        let mut counts = EpisodeCounts::default();
        for step in 0..steps {
            let allocator = (step >= decides).then_some(&allocator);
            let behaviour = Behaviour { agents: &agents, epsilon: 0.0, allocator };
            let memory = Memory {
                records: &mut Replay::new(100, RecordLayout { agents: 5, buildings: 1 }),
                segments: Some(&mut *segments),
            };
            rollout.step(behaviour, memory, &mut counts).unwrap();
        }
        counts
    }

    fn rollout(config: &Config) -> Rollout {
        Rollout::new(config, config.agent_shape().unwrap(), 1).unwrap()
    }

    #[test]
    fn segments_join_decisions_of_one_episode() {
        let mut segments = Segments::new(10_000);
        let decisions = play(&mut rollout(&config(200)), 600, 300, &mut segments).decisions;
        assert!(segments.len() > 300 && segments.len() as u64 <= decisions);
        assert!(segments.fits(10_000));
        let (mut ends, mut full) = (0, 0);
        for segment in (0..segments.len()).map(|index| segments.get(index)) {
            let kinds = |decision: &Decision| {
                decision.agents.iter().map(|agent| agent.kind).collect::<Vec<_>>()
            };
            assert_eq!(kinds(&segment.now), kinds(&segment.next));
            for task in &segment.now.allocation {
                assert!(segment.now.buildings[usize::from(*task)].is_open());
            }
            ends += usize::from(segment.discount == 0.0);
            full += usize::from((segment.discount - 0.99_f32.powi(5)).abs() < 1e-6);
        }
        assert!(ends > 0 && full > 100, "{ends} ends, {full} full segments");
    }

    #[test]
    fn a_segment_that_runs_out_of_time_is_dropped() {
        let mut rollout = rollout(&config(5));
        let mut segments = Segments::new(100);
        play(&mut rollout, 4, 9, &mut segments);
        let before = segments.len() as u64;
        let decisions = play(&mut rollout, 1, 9, &mut segments).decisions;
        assert_eq!(segments.len() as u64, before + decisions, "only decisions end segments");
        assert_eq!(play(&mut rollout, 1, 9, &mut segments).decisions, 3);
        assert_eq!(segments.len() as u64, before + decisions, "a new episode joins nothing");
    }

    #[test]
    fn episodes_are_counted_with_what_they_earned() {
        // The same episodes, which end in one of them.
        let (mut short, mut long) = (rollout(&config(30)), rollout(&config(200)));
        let counts = play(&mut short, 30, 99, &mut Segments::new(100));
        assert_eq!(play(&mut long, 30, 99, &mut Segments::new(100)).episodes, 0);
        let earned: f64 =
            (0..long.instances()).map(|index| long.city.metrics(index).episode_return).sum();
        assert_eq!((counts.episodes, counts.timed_out, counts.solved), (3, 3, 0));
        assert!(earned != 0.0 && (counts.return_sum - earned).abs() < 1e-9, "{counts:?}");
    }

    #[test]
    fn a_snapshot_goes_on_as_its_rollout() {
        let config = config(200);
        let (mut first, mut second) = (rollout(&config), rollout(&config));
        play(&mut first, 7, 0, &mut Segments::new(100));
        let snapshot = first.snapshot();
        assert_eq!(snapshot.len(), 3);
        second.restore(snapshot.clone()).unwrap();
        let after = [&mut first, &mut second].map(|rollout| {
            play(rollout, 7, 0, &mut Segments::new(100));
            rollout.snapshot()
        });
        assert_eq!(after[0], after[1]);
        assert_ne!(after[0], snapshot);

        let wrongs: [fn(&mut Vec<InstanceSnapshot>); 3] = [
            |snapshot| snapshot.truncate(2),
            |snapshot| snapshot[1].instance.decisions.allocation.push(0),
            |snapshot| snapshot[1].instance.last_actions.push(0),
        ];
        for wrong in wrongs {
            let mut snapshot = snapshot.clone();
            wrong(&mut snapshot);
            assert!(second.restore(snapshot).is_err());
        }
    }

    /// Agents that like an action the more the higher its number is.
    fn fond_of_high_numbers(shape: UtilityShape) -> UtilityNetwork {
        let mut parameters = vec![0.0; shape.parameters()];
        let biases = shape.tensors().into_iter().find(|tensor| tensor.name == "head.bias");
        let biases = &mut parameters[biases.unwrap().range];
        biases.iter_mut().enumerate().for_each(|(action, bias)| *bias = action as f32);
        UtilityNetwork::from_parameters(shape, parameters).unwrap()
    }

    #[test]
    fn agents_explore_as_often_as_their_instance_and_evenly() {
        let mut config = config(200);
        config.exploration.spread = vec![0.0, 0.5, 1.0];
        let mut rollout = rollout(&config);
        let agents = fond_of_high_numbers(config.agent_shape().unwrap());
        let mut records = Replay::new(100, RecordLayout { agents: 5, buildings: 1 });
        // Of agents in the open, with five available actions: how often each of these was taken.
        let mut taken = [[0.0; 5]; 3];
        for _ in 0..1500 {
            let choices: Vec<Vec<u16>> = (0..3)
                .map(|index| rollout.city.city(index).agents.iter().map(|a| a.available).collect())
                .collect();
            let behaviour = Behaviour { agents: &agents, epsilon: 1.0, allocator: None };
            let memory = Memory { records: &mut records, segments: None };
            rollout.step(behaviour, memory, &mut EpisodeCounts::default()).unwrap();
            for ((choices, instance), taken) in
                choices.iter().zip(&rollout.instances).zip(&mut taken)
            {
                let acted = choices.iter().zip(&instance.last_actions);
                for (available, action) in acted.filter(|(_, action)| **action != NO_ACTION) {
                    assert_eq!(available >> action & 1, 1, "only available actions are taken");
                    if available.count_ones() == 5 {
                        taken[(available & ((1 << action) - 1)).count_ones() as usize] += 1.0;
                    }
                }
            }
        }
        for (taken, epsilon) in taken.iter().zip([0.0, 0.5, 1.0]) {
            let total: f64 = taken.iter().sum();
            assert!(total > 1000.0, "{taken:?}");
            for (place, count) in taken.iter().enumerate() {
                let greedy = f64::from(u8::from(place == 4));
                let share = epsilon / 5.0 + (1.0 - epsilon) * greedy;
                assert!((count / total - share).abs() < 0.04, "{epsilon}: {taken:?}");
            }
        }
    }
}
