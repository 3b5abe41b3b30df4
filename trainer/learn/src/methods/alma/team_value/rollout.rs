//! Deciding while learning: episodes of greedy agents under allocations that are changed at random.

use rand_core::Rng;
use sortie_envs::save_the_city::{
    AllocationRule, City, DecisionPoints, SaveTheCity, ScenarioSet, UNASSIGNED,
};
use sortie_envs::{Environment, Subtasks};

use super::config::{BehaviourConfig, TeamValueConfig};
use super::search::TeamSearch;
use super::segments::{Decision, Segment, Segments};
use crate::error::LearnError;
use crate::evaluate::{NetworkTeam, Scene, Team};
use crate::methods::alma::{NO_ACTION, UtilityNetwork};
use crate::random::{Generator, Purpose, below, chance, generator};

/// Tells the streams of this rollout from those of the agents' rollout.
const STREAMS: u64 = 1 << 32;

/// Who decides.
#[derive(Clone, Copy, Debug)]
pub enum Behaviour<'a> {
    /// The coordinated rule or the heuristic, with equal chance.
    Rules,
    /// The best allocation by a team-value network.
    Network(&'a UtilityNetwork),
}

/// An episode and the segment that has begun in it.
#[derive(Clone, Debug)]
struct Instance {
    generator: Generator,
    points: DecisionPoints,
    tasks_changed: bool,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    segment: Option<Segment>,
}

/// The instances of a run, played by agents that learn no more.
#[derive(Debug)]
pub struct TeamValueRollout<'a> {
    city: SaveTheCity,
    team: NetworkTeam<'a>,
    instances: Vec<Instance>,
    search: TeamSearch,
    behaviour: BehaviourConfig,
    team_max: usize,
    discount: f32,
    /// `[instances, A]`
    actions: Vec<u16>,
}

impl<'a> TeamValueRollout<'a> {
    /// Starts an episode in every instance.
    pub fn new(
        config: &TeamValueConfig,
        agents: &'a UtilityNetwork,
        seed: u64,
    ) -> Result<Self, LearnError> {
        let set = ScenarioSet::named(&config.environment.set)?;
        let (count, agents_max) = (config.environment.instances, set.max_agents);
        let city = SaveTheCity::new(set, config.environment.constants, count, 0)?;
        let instance = |index| Instance {
            generator: generator(seed, Purpose::Rollout, STREAMS + index),
            points: DecisionPoints::every(config.decisions.interval),
            tasks_changed: false,
            allocation: vec![UNASSIGNED; agents_max],
            last_actions: vec![NO_ACTION; agents_max],
            segment: None,
        };
        let mut rollout = Self {
            city,
            team: NetworkTeam::new(agents),
            instances: (0..count as u64).map(instance).collect(),
            search: TeamSearch::new(config.shape(), config.decisions.team_max),
            behaviour: config.behaviour.clone(),
            team_max: config.decisions.team_max,
            discount: config.decisions.discount,
            actions: vec![0; count * agents_max],
        };
        (0..count).for_each(|index| rollout.restart(index));
        Ok(rollout)
    }

    /// Number of instances: environment steps that one [`step`](Self::step) takes.
    pub fn instances(&self) -> usize {
        self.instances.len()
    }

    /// Takes one step in every instance, stores the segments that end, returns the decisions made.
    pub fn step(
        &mut self,
        behaviour: Behaviour<'_>,
        replay: &mut Segments,
    ) -> Result<u64, LearnError> {
        let mut decisions = 0;
        for index in 0..self.instances.len() {
            let instance = &mut self.instances[index];
            if instance.points.is_due(instance.tasks_changed) {
                self.decide(index, behaviour, replay)?;
                decisions += 1;
            }
        }
        let agents = self.city.shape().agents;
        let numbered = self.instances.iter().enumerate();
        let scenes: Vec<Scene<'_>> = numbered
            .map(|(index, Instance { allocation, last_actions, .. })| Scene {
                city: self.city.city(index),
                allocation,
                last_actions,
            })
            .collect();
        self.team.act(&scenes, &mut self.actions, agents)?;
        for index in 0..self.instances.len() {
            self.advance(index, replay)?;
        }
        Ok(decisions)
    }

    /// Makes a decision, which ends the segment of the one before.
    fn decide(
        &mut self,
        index: usize,
        behaviour: Behaviour<'_>,
        replay: &mut Segments,
    ) -> Result<(), LearnError> {
        let city = self.city.city(index);
        let Instance { generator, allocation, segment, .. } = &mut self.instances[index];
        let moved = match behaviour {
            Behaviour::Rules => {
                let rules = [AllocationRule::Coordinated, AllocationRule::Heuristic];
                rules[below(generator, 2)].allocate(city, generator, allocation);
                self.behaviour.rule_moved
            }
            Behaviour::Network(network) => {
                self.search.allocate(network, city, allocation)?;
                self.behaviour.moved
            }
        };
        if chance(generator, self.behaviour.moved_decisions) {
            move_some(city, moved, self.team_max, generator, allocation);
        }
        let decision = Decision::new(city, allocation);
        if let Some(mut segment) = segment.take() {
            segment.next = decision.clone();
            replay.push(segment);
        }
        *segment = Some(Segment {
            rewards: vec![0.0; decision.buildings.len()],
            discount: 1.0,
            next: decision.clone(),
            now: decision,
        });
        Ok(())
    }

    fn advance(&mut self, index: usize, replay: &mut Segments) -> Result<(), LearnError> {
        let agents = self.city.shape().agents;
        let actions = &self.actions[index * agents..][..agents];
        let instance = &mut self.instances[index];
        let generator = &mut instance.generator;
        let outcome = self.city.step_with_losers(index, actions, |first, second| {
            if below(generator, 2) == 0 { first } else { second }
        })?;
        for (last, action) in instance.last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        instance.tasks_changed = outcome.tasks_changed;
        if let Some(segment) = &mut instance.segment {
            for (sum, reward) in segment.rewards.iter_mut().zip(self.city.task_rewards(index)) {
                *sum += segment.discount * *reward as f32;
            }
            segment.discount *= self.discount;
        }
        if outcome.done() {
            // After a time-out nobody decides, so that there is no next team to value.
            if let Some(segment) = instance.segment.take().filter(|_| outcome.terminated) {
                replay.push(Segment { discount: 0.0, ..segment });
            }
            self.restart(index);
        }
        Ok(())
    }

    fn restart(&mut self, index: usize) {
        let instance = &mut self.instances[index];
        instance.points.restart();
        instance.tasks_changed = false;
        instance.last_actions.fill(NO_ACTION);
        self.city.seed(index, instance.generator.next_u64());
        self.city.reset(index);
    }
}

/// Sends a share of the agents to random open buildings, except where the team is full.
fn move_some(
    city: City<'_>,
    share: f64,
    team_max: usize,
    generator: &mut Generator,
    allocation: &mut [u8],
) {
    let numbered = city.buildings.iter().enumerate();
    let open: Vec<u8> = numbered.filter(|(_, b)| b.is_open()).map(|(task, _)| task as u8).collect();
    for agent in 0..city.agents.len() {
        if chance(generator, share) && !open.is_empty() {
            let task = open[below(generator, open.len())];
            if allocation.iter().filter(|own| **own == task).count() < team_max {
                allocation[agent] = task;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::alma::Config;
    use sortie_envs::save_the_city::ACTIONS;

    fn agents() -> UtilityNetwork {
        let mut weights = generator(1, Purpose::Weights, 0);
        UtilityNetwork::initialise(Config::default().network.shape(ACTIONS), 8.0, &mut weights)
    }

    fn config(episode_limit: u32) -> TeamValueConfig {
        let mut config = TeamValueConfig::default();
        config.environment.constants.episode_limit = episode_limit;
        config.environment.instances = 3;
        config.network.width = 8;
        config
    }

    #[test]
    fn segments_join_decisions_of_one_episode() {
        let (config, agents) = (config(200), agents());
        let mut rollout = TeamValueRollout::new(&config, &agents, 1).unwrap();
        let mut replay = Segments::new(10_000);
        let network =
            UtilityNetwork::initialise(config.shape(), 8.0, &mut generator(2, Purpose::Weights, 0));
        let mut decisions = 0;
        for step in 0..600 {
            let behaviour =
                if step < 300 { Behaviour::Rules } else { Behaviour::Network(&network) };
            decisions += rollout.step(behaviour, &mut replay).unwrap();
        }
        assert!(replay.len() > 300 && replay.len() as u64 <= decisions);
        let (mut ends, mut full) = (0, 0);
        for segment in (0..replay.len()).map(|index| replay.get(index)) {
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
        let (config, agents) = (config(5), agents());
        let mut rollout = TeamValueRollout::new(&config, &agents, 1).unwrap();
        let mut replay = Segments::new(100);
        for _ in 0..4 {
            rollout.step(Behaviour::Rules, &mut replay).unwrap();
        }
        let before = replay.len();
        let decisions = rollout.step(Behaviour::Rules, &mut replay).unwrap();
        assert_eq!(replay.len() as u64, before as u64 + decisions, "only decisions end segments");
        assert_eq!(rollout.step(Behaviour::Rules, &mut replay).unwrap(), 3);
        assert_eq!(replay.len() as u64, before as u64 + decisions, "a new episode joins nothing");
    }
}
