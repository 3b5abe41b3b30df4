//! Acting while learning: rounds of whole episodes, one in each of several environments.

use rand_core::Rng;
use serde::{Deserialize, Serialize};
use sortie_envs::Environment;
use sortie_envs::random::chance;
use sortie_envs::save_the_city::{
    AllocationRule, City, DecisionPoints, SaveTheCity, ScenarioSet, UNASSIGNED,
};
use sortie_nn::random::Generator;

use super::config::Config;
use super::low_level::coach::Advice;
use super::replay::{Episode, Moment};
use crate::alma::evaluate::{Agents, Players, Scene};
use crate::alma::records::{NO_ACTION, UtilityShape, best_action, random_action};
use sortie_learn::LearnError;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;

/// How much is tried out in a round.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exploration {
    /// How often an agent takes a random available action.
    pub actions: f32,
    /// How often a decision takes the first proposal instead of the critic's best.
    pub proposal: f32,
    /// How often an agent is given a random open subtask at a decision.
    pub allocation: f32,
}

/// What allocates agents at decision points.
pub trait Decide {
    /// Writes the building of every agent. `allocation` comes with what was in force before,
    /// [`UNASSIGNED`] at the first decision of an episode.
    fn decide(
        &mut self,
        city: City<'_>,
        exploration: Exploration,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError>;
}

impl Decide for AllocationRule {
    fn decide(
        &mut self,
        city: City<'_>,
        _: Exploration,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.allocate(city, generator, allocation);
        Ok(())
    }
}

/// What one environment remembers between steps.
#[derive(Debug)]
struct Instance {
    points: DecisionPoints,
    tasks_changed: bool,
    decision: bool,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    /// What a coach has told the agents, `[A, R]`; empty without one.
    strategies: Vec<f32>,
    episode: Episode,
    episode_return: f64,
}

/// The generators of all environments: all that outlives a round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RolloutGenerators(Vec<Generator>);

/// The environments of a run and the buffers to act in them.
#[derive(Debug)]
pub struct Rollout {
    city: SaveTheCity,
    instances: Vec<Instance>,
    /// They draw episodes, collisions, allocations and exploration.
    generators: RolloutGenerators,
    players: Players,
    /// `[instances, A]`
    actions: Vec<u16>,
}

impl Rollout {
    /// Environments in which no episode runs yet.
    pub fn new(config: &Config, shape: UtilityShape, seed: u64) -> Result<Self, LearnError> {
        let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
        let (count, agents) = (config.environment.instances, set.max_agents);
        let city = SaveTheCity::new(set, config.environment.constants, count, 0)
            .map_err(LearnError::environment)?;
        let instance = |_| Instance {
            points: DecisionPoints::every(config.allocation.interval),
            tasks_changed: false,
            decision: false,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            episode: Episode::default(),
            episode_return: 0.0,
        };
        let generators = (0..count).map(|index| generator(seed, Purpose::Rollout, index as u64));
        Ok(Self {
            city,
            instances: (0..count).map(instance).collect(),
            generators: RolloutGenerators(generators.collect()),
            players: Players::new(config.low_level.conditioning, shape),
            actions: vec![0; count * agents],
        })
    }

    /// The generators, for a checkpoint between two rounds.
    pub fn generators(&self) -> &RolloutGenerators {
        &self.generators
    }

    /// Goes on with generators of a checkpoint.
    pub fn restore(&mut self, generators: RolloutGenerators) -> Result<(), LearnError> {
        if generators.0.len() != self.generators.0.len() {
            return Err(LearnError::Config("the checkpoint has other environments".to_owned()));
        }
        self.generators = generators;
        Ok(())
    }

    /// Plays one episode in every environment; `added` is the number of steps taken before.
    ///
    /// Environments whose episode is over wait for the others, as in the public code.
    pub fn round(
        &mut self,
        agents: Agents<'_>,
        allocator: Option<&mut dyn Decide>,
        exploration: Exploration,
        added: u64,
        counts: &mut EpisodeCounts,
    ) -> Result<Vec<Episode>, LearnError> {
        let mut allocator = allocator;
        let mut advice = agents.coach.map(Advice::new);
        (0..self.instances.len()).for_each(|index| self.begin(index, added));
        let mut running: Vec<usize> = (0..self.instances.len()).collect();
        while !running.is_empty() {
            if let Some(allocator) = &mut allocator {
                self.decide(&running, &mut **allocator, exploration, counts)?;
            }
            if let Some(advice) = &mut advice {
                self.advise(&running, advice, counts);
            }
            self.choose(&running, agents, exploration.actions)?;
            for index in &running {
                self.advance(*index, counts)?;
            }
            running.retain(|index| !self.city.is_done(*index));
        }
        Ok(self.instances.iter_mut().map(|i| std::mem::take(&mut i.episode)).collect())
    }

    fn begin(&mut self, index: usize, added: u64) {
        let mut random = sortie_envs::random::generator(self.generators.0[index].next_u64());
        self.city.reset(index, &mut random);
        let instance = &mut self.instances[index];
        instance.points.restart();
        instance.tasks_changed = false;
        instance.decision = false;
        instance.allocation.fill(UNASSIGNED);
        instance.last_actions.fill(NO_ACTION);
        instance.strategies.clear();
        instance.episode_return = 0.0;
        instance.episode.begin(self.city.city(index), added);
    }

    fn decide(
        &mut self,
        running: &[usize],
        allocator: &mut dyn Decide,
        exploration: Exploration,
        counts: &mut EpisodeCounts,
    ) -> Result<(), LearnError> {
        for index in running {
            let instance = &mut self.instances[*index];
            instance.decision = instance.points.is_due(instance.tasks_changed);
            if instance.decision {
                let (city, generator) = (self.city.city(*index), &mut self.generators.0[*index]);
                allocator.decide(city, exploration, generator, &mut instance.allocation)?;
                counts.decisions += 1;
            }
        }
        Ok(())
    }

    /// Lets a coach tell the agents where a decision is due.
    fn advise(&mut self, running: &[usize], advice: &mut Advice<'_>, counts: &mut EpisodeCounts) {
        for index in running {
            let instance = &mut self.instances[*index];
            instance.decision = instance.points.is_due(instance.tasks_changed);
            if instance.decision {
                let (city, generator) = (self.city.city(*index), &mut self.generators.0[*index]);
                advice.draw(city, generator, &mut instance.strategies);
                counts.decisions += 1;
            }
        }
    }

    /// Writes the actions of all agents: the best by their utilities, or a random one.
    fn choose(
        &mut self,
        running: &[usize],
        agents: Agents<'_>,
        epsilon: f32,
    ) -> Result<(), LearnError> {
        let Self { city, instances, generators, players, actions, .. } = self;
        let scene = |index: &usize| {
            let Instance { allocation, last_actions, strategies, .. } = &instances[*index];
            let city = city.city(*index);
            Scene { world: *index, city, allocation, last_actions, strategies }
        };
        let scenes: Vec<Scene<'_>> = running.iter().map(scene).collect();
        let slots = city.shape().agents;
        actions.fill(0);
        players.act(agents, &scenes, slots, |place, agent, utilities| {
            let available = scenes[place].city.agents[agent].available;
            let generator = &mut generators.0[running[place]];
            let action = if chance(generator, epsilon.into()) {
                random_action(available, generator)
            } else {
                best_action(utilities, available)
            };
            actions[running[place] * slots + agent] = action.into();
        })
    }

    fn advance(&mut self, index: usize, counts: &mut EpisodeCounts) -> Result<(), LearnError> {
        let instance = &mut self.instances[index];
        let agents = self.city.shape().agents;
        let actions = &self.actions[index * agents..][..agents];
        let Instance { allocation, decision, episode, .. } = instance;
        let (city, decision) = (self.city.city(index), *decision);
        episode.push_state(Moment { city, allocation, decision, actions });

        let generator = &mut self.generators.0[index];
        let outcome = self.city.step(index, actions, generator)?;
        episode.push_rewards(outcome.reward, self.city.task_rewards(index));
        instance.episode_return += outcome.reward;
        instance.tasks_changed = outcome.tasks_changed;
        for (last, action) in instance.last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        if outcome.done() {
            let Instance { allocation, episode, episode_return, .. } = instance;
            let city = self.city.city(index);
            let actions = &self.actions[index * agents..][..agents];
            episode.push_state(Moment { city, allocation, decision: false, actions });
            episode.terminated = outcome.terminated;
            counts.episodes += 1;
            counts.solved += u64::from(self.city.metrics(index).solved);
            counts.timed_out += u64::from(outcome.timed_out);
            counts.return_sum += *episode_return;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::{Conditioning, INPUT_COLUMNS, UtilityNetwork};
    use crate::alma::windows::low_level::{LowLevel, TaskOrder, agent_utilities};
    use crate::alma::windows::{Replay, SampleShape, Shaping, cut_windows};
    use sortie_envs::save_the_city::ACTIONS;

    #[test]
    fn a_round_plays_whole_episodes_and_decides_by_the_rules() {
        let mut config = Config::default();
        config.environment.instances = 3;
        config.environment.constants.episode_limit = 30;
        let shape = UtilityShape {
            input: INPUT_COLUMNS,
            width: 8,
            heads: 4,
            base: 8,
            actions: ACTIONS,
            skip: false,
        };
        let mut weights = generator(1, Purpose::Weights, 0);
        let agents = UtilityNetwork::initialise(shape, 8.0, &mut weights);
        let players = Agents::new(&agents);
        let mut rollout = Rollout::new(&config, shape, 5).unwrap();
        let mut counts = EpisodeCounts::default();
        let exploration = Exploration { actions: 0.5, ..Exploration::default() };
        let mut play = |rollout: &mut Rollout| {
            let rule: &mut dyn Decide = &mut AllocationRule::Heuristic;
            rollout.round(players, Some(rule), exploration, 7, &mut counts).unwrap()
        };
        let before = rollout.generators().clone();
        let episodes = play(&mut rollout);
        assert_eq!(episodes.len(), 3);
        for episode in &episodes {
            assert_eq!((episode.states(), episode.added), (episode.steps() + 1, 7));
            assert!(episode.terminated || episode.steps() == 30);
            let mut since = 0;
            for state in 0..episode.steps() {
                let open = |state: usize| episode.city(state).open_tasks();
                let changed = state > 0 && open(state) != open(state - 1);
                let due = state == 0 || since >= 5 || changed;
                assert_eq!(episode.decision(state), due, "state {state}");
                since = if due { 1 } else { since + 1 };
            }
            assert!(!episode.decision(episode.steps()), "the final state decides nothing");
        }
        rollout.restore(before).unwrap();
        assert_eq!(play(&mut rollout), episodes, "the generators are all that outlives a round");
        assert_eq!(counts.episodes, 6);
    }

    #[test]
    fn agents_see_in_windows_what_they_saw_when_they_acted() {
        for (conditioning, recurrent) in [
            (Conditioning::Mask, false),
            (Conditioning::Input, false),
            (Conditioning::None, false),
            (Conditioning::Mask, true),
        ] {
            let mut config = Config::default();
            config.low_level.recurrent = recurrent;
            config.environment.instances = 2;
            config.environment.constants.episode_limit = 20;
            config.low_level.conditioning = conditioning;
            (config.low_level.width, config.low_level.base) = (8, 8);
            let set = ScenarioSet::named(&config.environment.set).unwrap();
            let sizes = config.sizes(&set);
            let mut weights = generator(1, Purpose::Weights, 0);
            let level = LowLevel::new(config.low_level.clone(), sizes, &mut weights);
            let shape = level.online.agents.shape();
            let mut rollout = Rollout::new(&config, shape, 5).unwrap();
            let exploration = Exploration { actions: 0.5, ..Exploration::default() };
            let rule: &mut dyn Decide = &mut AllocationRule::Random;
            let counts = &mut EpisodeCounts::default();
            let played = rollout.round(level.players(), Some(rule), exploration, 0, counts);
            let mut replay = Replay::new(2);
            played.unwrap().into_iter().for_each(|episode| replay.push(episode));

            let shaping = Shaping::default();
            let sample = SampleShape { windows: 2, steps: 64, agents: 5, tasks: 6, shaping };
            let windows = cut_windows(&replay, &[0, 1], sample, &mut weights);
            let order = TaskOrder::identity(6);
            let in_windows = agent_utilities(level.players(), &windows, conditioning, &order);
            let mut players = Players::new(conditioning, shape);
            let mut compared = 0;
            for (world, episode) in replay.episodes().iter().enumerate() {
                let mut last_actions = vec![NO_ACTION; episode.agents];
                for state in 0..episode.steps() {
                    let (city, allocation) = (episode.city(state), episode.allocation(state));
                    let scene = Scene {
                        world,
                        city,
                        allocation,
                        last_actions: &last_actions,
                        strategies: &[],
                    };
                    let act = |_: usize, agent: usize, utilities: &[f32]| {
                        let at = ((world * windows.shape.steps + state) * 5 + agent) * ACTIONS;
                        for (acted, learned) in utilities.iter().zip(&in_windows[at..]) {
                            assert!((acted - learned).abs() < 1e-5, "{acted} {learned}");
                        }
                        compared += 1;
                    };
                    players.act(level.players(), &[scene], 5, act).unwrap();
                    last_actions.copy_from_slice(episode.actions(state));
                }
            }
            assert!(compared > 50, "{compared}");
        }
    }
}
