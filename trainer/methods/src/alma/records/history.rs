//! Turns the steps of one episode into records with n-step returns.
//!
//! A record of step t and subtask b sums the rewards of b for up to n steps. It ends earlier, and
//! bootstraps with the team of step t, when b gets another team; without bootstrapping when b is
//! finished. A time-out bootstraps from the final state.
//!
//! Without subtasks there is one record for each step: everybody is its team, its rewards are the whole
//! team's, and only the end of the episode cuts it.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use sortie_envs::{AgentSet, EntitySet, Environment, Observation, members};

use super::config::ReturnsConfig;
use super::replay::{Record, Replay};
use crate::alma::agents::Conditioning;

/// How rewards of several steps become one target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Returns {
    /// Steps n after which a record bootstraps.
    pub steps: u32,
    /// Discount per step.
    pub discount: f32,
    /// Potential of one cell between an agent and its subtask; 0 leaves the rewards alone.
    pub shaping: f32,
}

impl From<&ReturnsConfig> for Returns {
    fn from(config: &ReturnsConfig) -> Self {
        let ReturnsConfig { steps, discount, shaping } = *config;
        Self { steps, discount, shaping }
    }
}

impl Returns {
    /// How many moments a step and the one to bootstrap from lie apart at most, where so many instances are stepped in
    /// turn and each adds two at most.
    pub fn lag(&self, instances: usize) -> u64 {
        2 * (u64::from(self.steps) + 2) * instances as u64
    }
}

/// Rewards of one step.
#[derive(Clone, Copy, Debug)]
pub struct StepRewards<'a> {
    /// Reward of every subtask.
    pub tasks: &'a [f64],
    /// Reward of the whole team.
    pub team: f64,
}

/// A state that an episode comes to.
#[derive(Clone, Copy)]
pub struct Reached<'a> {
    /// What observes it.
    pub environment: &'a dyn Environment,
    /// The state.
    pub state: &'a [u8],
    /// The number of its moment.
    pub number: u64,
}

/// A past step whose records are not all complete.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Frame {
    /// The number of its moment.
    number: u64,
    /// The subtask of every agent that existed.
    allocation: Vec<u8>,
    /// Potential of each task's team.
    potentials: Vec<f32>,
    /// Things of each task.
    things: Vec<EntitySet>,
    /// Rewards of each task since this step, discounted.
    returns: Vec<f32>,
    /// Discount to the power of the steps since.
    weight: f32,
    steps: u32,
    /// Tasks, as bits, whose record is incomplete.
    pending: u32,
}

impl Frame {
    fn team(&self, task: usize) -> AgentSet {
        let members = self.allocation.iter().enumerate();
        let members = members.filter(|(_, own)| usize::from(**own) == task);
        members.fold(0, |team, (agent, _)| team | 1 << agent)
    }

    fn same_team(&self, task: usize, allocation: &[u8]) -> bool {
        let at = |task_of: u8| usize::from(task_of) == task;
        self.allocation.iter().zip(allocation).all(|(a, b)| at(*a) == at(*b))
    }
}

/// The incomplete records of one running episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct History {
    rules: Rules,
    frames: VecDeque<Frame>,
    spare: Vec<Frame>,
}

impl History {
    /// An empty history.
    pub fn new(conditioning: Conditioning, returns: Returns) -> Self {
        let rules = Rules { conditioning, returns };
        Self { rules, frames: VecDeque::new(), spare: Vec::new() }
    }

    /// Completes records whose n steps are over or whose subtask has another team now.
    ///
    /// Call it once an allocation is in force and before the actions of the step.
    pub fn decide(&mut self, now: Reached<'_>, allocation: &[u8], replay: &mut Replay) {
        let rules = self.rules;
        for frame in &mut self.frames {
            for task in tasks(frame.pending) {
                let same_team =
                    !rules.conditioning.has_subtasks() || frame.same_team(task, allocation);
                if frame.steps >= rules.returns.steps || !same_team {
                    rules.complete(frame, task, Some(now), replay);
                }
            }
        }
        self.drop_complete();
    }

    /// Begins the records of the state that [`decide`](Self::decide) saw, in which there is so much to be seen; the
    /// replay learns who acts for what.
    pub fn begin(
        &mut self,
        now: Reached<'_>,
        seen: &Observation,
        allocation: &[u8],
        replay: &mut Replay,
    ) {
        let mut frame = self.spare.pop().unwrap_or_default();
        frame.allocation.clear();
        frame.allocation.extend_from_slice(&allocation[..seen.agents()]);
        if !self.rules.conditioning.has_subtasks() {
            frame.allocation.fill(WHOLE as u8);
        }
        replay.moments.allocate(now.number, &frame.allocation);
        frame.number = now.number;
        frame.returns.clear();
        frame.returns.resize(seen.tasks().max(1), 0.0);
        frame.potentials.clear();
        frame.potentials.resize(frame.returns.len(), 0.0);
        frame.things.clear();
        frame.things.extend((0..frame.returns.len()).map(|task| self.rules.things(seen, task)));
        frame.weight = 1.0;
        frame.steps = 0;
        frame.pending = 0;
        for task in tasks(self.rules.open_tasks(seen.open_tasks)) {
            let team = frame.team(task);
            if team != 0 {
                frame.pending |= 1 << task;
                frame.potentials[task] = self.rules.potential(now, team, task);
            }
        }
        self.frames.push_back(frame);
    }

    /// Adds the rewards of the step just taken and completes the records of subtasks that are not open any more.
    pub fn reward(&mut self, open_tasks: u32, rewards: StepRewards<'_>, replay: &mut Replay) {
        let rules = self.rules;
        let open = rules.open_tasks(open_tasks);
        for frame in &mut self.frames {
            for task in tasks(frame.pending) {
                let reward = if rules.conditioning.has_subtasks() {
                    rewards.tasks[task]
                } else {
                    rewards.team
                };
                frame.returns[task] += frame.weight * reward as f32;
            }
            frame.weight *= rules.returns.discount;
            frame.steps += 1;
            for task in tasks(frame.pending & !open) {
                rules.complete(frame, task, None, replay);
            }
        }
        self.drop_complete();
    }

    /// Ends the episode: what is incomplete bootstraps from the state in which time ran out, and is worth nothing where
    /// there is none.
    pub fn end(&mut self, timed_out: Option<Reached<'_>>, replay: &mut Replay) {
        for frame in &mut self.frames {
            for task in tasks(frame.pending) {
                self.rules.complete(frame, task, timed_out, replay);
            }
        }
        self.drop_complete();
    }

    fn drop_complete(&mut self) {
        while self.frames.front().is_some_and(|frame| frame.pending == 0) {
            self.spare.extend(self.frames.pop_front());
        }
    }
}

/// The only task where there are no subtasks: everybody works on it, and the episode's end closes it.
const WHOLE: usize = 0;

/// How steps become records.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Rules {
    conditioning: Conditioning,
    returns: Returns,
}

impl Rules {
    /// Tasks, as bits, that there is still something to do for.
    fn open_tasks(self, open_tasks: u32) -> u32 {
        if self.conditioning.has_subtasks() { open_tasks } else { 1 << WHOLE }
    }

    /// The things that a team sees in its step: those of its subtask under the mask, else all.
    fn things(self, seen: &Observation, task: usize) -> EntitySet {
        match self.conditioning {
            Conditioning::Mask => seen.things_of(task),
            Conditioning::Input | Conditioning::None => seen.things(),
        }
    }

    /// Stores the record of one task and takes it off the frame's list.
    ///
    /// `next` is the state to bootstrap from, if there is one.
    fn complete(
        self,
        frame: &mut Frame,
        task: usize,
        next: Option<Reached<'_>>,
        replay: &mut Replay,
    ) {
        frame.pending &= !(1 << task);
        let discount = if next.is_some() { frame.weight } else { 0.0 };
        let later = next.map_or(0.0, |next| self.potential(next, frame.team(task), task));
        let moments = [frame.number, next.map_or(frame.number, |next| next.number)];
        let reward = frame.returns[task] + discount * later - frame.potentials[task];
        let mut record = Record::new(task, moments, frame.things[task]);
        (record.reward, record.discount) = (reward, discount);
        replay.push(record);
    }

    /// Potential of a state for a team at a task.
    fn potential(self, at: Reached<'_>, team: AgentSet, task: usize) -> f32 {
        let task_of_team = self.conditioning.has_subtasks().then_some(task);
        at.environment.potential(at.state, self.returns.shaping, team, task_of_team)
    }
}

/// The members of a set of tasks.
fn tasks(set: u32) -> impl Iterator<Item = usize> {
    members(set.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::replay::Sample;
    use crate::alma::records::toy::{AGENTS, Street, Toy, toy};
    use sortie_envs::Environment;

    const RETURNS: Returns = Returns { steps: 3, discount: 0.5, shaping: 0.0 };

    /// Two agents at door 7; two sites, at doors 4 and 15.
    struct World {
        environment: Toy,
        street: Street,
        allocation: Vec<u8>,
        last_actions: Vec<u8>,
        history: History,
        replay: Replay,
    }

    impl World {
        fn new(returns: Returns, allocation: [u8; 2]) -> Self {
            Self::with(Conditioning::Mask, returns, allocation)
        }

        fn with(conditioning: Conditioning, returns: Returns, allocation: [u8; 2]) -> Self {
            let environment = toy();
            let mut everybody = vec![sortie_envs::UNASSIGNED; AGENTS];
            everybody[..2].copy_from_slice(&allocation);
            Self {
                street: Street { agents: vec![7; 2], ..Street::new(2, &[4, 15]) },
                allocation: everybody,
                last_actions: vec![2; AGENTS],
                history: History::new(conditioning, returns),
                replay: Replay::new(100, returns.lag(1), environment.spec()),
                environment,
            }
        }

        /// Tells history and replay of the state that was reached.
        fn reach(&mut self, then: impl FnOnce(&mut History, Reached<'_>, &[u8], &mut Replay)) {
            let state = self.street.bytes();
            let number = self.replay.moments.push(&state, &self.last_actions);
            let now = Reached { environment: &self.environment, state: &state, number };
            then(&mut self.history, now, &self.allocation, &mut self.replay);
        }

        /// One step in which each site's task earns its reward.
        fn step(&mut self, actions: [u16; 2], rewards: [f64; 2], change: impl FnOnce(&mut Self)) {
            let seen = self.street.seen();
            self.reach(|history, now, allocation, replay| {
                history.decide(now, allocation, replay);
                history.begin(now, &seen, allocation, replay);
                replay.moments.act(now.number, &actions);
            });
            for (last, action) in self.last_actions.iter_mut().zip(actions) {
                *last = action as u8;
            }
            change(self);
            let rewards = StepRewards { tasks: &rewards, team: 10.0 };
            self.history.reward(self.street.seen().open_tasks, rewards, &mut self.replay);
        }

        fn decide(&mut self) {
            self.reach(|history, now, allocation, replay| history.decide(now, allocation, replay));
        }

        fn end(&mut self, timed_out: bool) {
            self.reach(|history, now, _, replay| history.end(timed_out.then_some(now), replay));
        }

        /// The doors of the team of a record in a state.
        fn doors(&self, record: usize, next: bool) -> Vec<u8> {
            let sample = self.replay.get(record);
            let moment = if next { sample.next } else { sample.now };
            members(sample.team().into()).map(|agent| moment.state[1 + agent]).collect()
        }

        /// (reward, discount, team size) of every record.
        fn records(&self) -> Vec<(f32, f32, usize)> {
            let record = |index| {
                let sample = self.replay.get(index);
                let size = sample.team().count_ones() as usize;
                (sample.record.reward, sample.record.discount, size)
            };
            (0..self.replay.len()).map(record).collect()
        }
    }

    fn nothing(_: &mut World) {}

    #[test]
    fn a_record_sums_three_steps_and_bootstraps() {
        let mut world = World::new(RETURNS, [0, 0]);
        for (action, reward) in [(1, 1.0), (2, 2.0), (0, 4.0)] {
            world.step([action, 0], [reward, 99.0], |world| world.street.agents[0] += 1);
            assert_eq!(world.replay.len(), 0);
        }
        world.decide();
        assert_eq!(world.records(), [(1.0 + 1.0 + 1.0, 0.125, 2)]);
        let Sample { now, next, .. } = world.replay.get(0);
        assert_eq!((now.last_actions[0], now.actions[0], next.last_actions[0]), (2, 1, 0));
        assert_eq!((world.doors(0, false), world.doors(0, true)), (vec![7, 7], vec![10, 7]));
    }

    #[test]
    fn another_team_ends_a_record_which_bootstraps_with_the_old_team() {
        let mut world = World::new(RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 3.0], nothing);
        world.allocation[..2].copy_from_slice(&[0, 0]);
        world.decide();
        // Both sites have another team: the first gained an agent, the second lost its only one.
        assert_eq!(world.records(), [(1.0, 0.5, 1), (3.0, 0.5, 1)]);
    }

    #[test]
    fn a_new_decision_for_the_same_team_ends_nothing() {
        let mut world = World::new(RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 0.0], nothing);
        world.decide();
        assert_eq!(world.replay.len(), 0);
    }

    #[test]
    fn a_closed_site_ends_its_records_without_bootstrapping() {
        let mut world = World::new(RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 0.0], nothing);
        world.step([1, 2], [8.0, 0.0], |world| world.street.sites[0].1 = false);
        assert_eq!(world.records(), [(1.0 + 4.0, 0.0, 1), (8.0, 0.0, 1)]);
        // A site without open work starts no more records.
        world.step([0, 2], [5.0, 0.0], nothing);
        assert_eq!(world.replay.len(), 2);
    }

    #[test]
    fn a_timeout_bootstraps_from_the_final_state_and_an_end_does_not() {
        for (timed_out, discount) in [(true, 0.5), (false, 0.0)] {
            let mut world = World::new(RETURNS, [0, 0]);
            world.step([1, 2], [1.0, 0.0], |world| world.street.agents[1] = 5);
            world.end(timed_out);
            assert_eq!(world.records(), [(1.0, discount, 2)]);
            assert!(world.history.frames.is_empty(), "nothing of the episode is kept");
            let next = if timed_out { 5 } else { 7 };
            assert_eq!(world.doors(0, true), [7, next]);
        }
    }

    #[test]
    fn shaping_adds_the_difference_of_potentials() {
        let returns = Returns { steps: 1, shaping: 0.5, ..RETURNS };
        let mut world = World::new(returns, [0, 0]);
        // Both are three doors away before, one of them two after.
        world.step([1, 0], [1.0, 0.0], |world| world.street.agents[0] -= 1);
        world.decide();
        assert_eq!(world.records(), [(1.0 + 0.5 * -2.5 + 3.0, 0.5, 2)]);

        let mut world = World::new(returns, [0, 0]);
        world.step([1, 0], [1.0, 0.0], |world| world.street.sites[0].1 = false);
        assert_eq!(world.records(), [(1.0 + 3.0, 0.0, 2)], "no later potential at the end");
    }

    #[test]
    fn a_record_holds_what_its_team_may_see() {
        let seen = |conditioning| {
            let mut world = World::with(conditioning, RETURNS, [1, 0]);
            world.step([1, 2], [1.0, 3.0], |world| world.allocation[1] = 1);
            world.decide();
            world.end(true);
            let record = |index| {
                let Sample { record, now, .. } = world.replay.get(index);
                let things = members(record.things()).map(|thing| thing - AGENTS);
                let team = world.replay.get(index).team();
                (team, record.task, now.allocation[..2].to_vec(), things.collect::<Vec<_>>())
            };
            (0..world.replay.len()).map(record).collect::<Vec<_>>()
        };
        assert_eq!(
            seen(Conditioning::Mask),
            [(0b10, 0, vec![1, 0], vec![0]), (0b01, 1, vec![1, 0], vec![1])],
            "the team and its site, with the tasks of the record's own step"
        );
        assert_eq!(
            seen(Conditioning::Input),
            [(0b10, 0, vec![1, 0], vec![0, 1]), (0b01, 1, vec![1, 0], vec![0, 1])],
            "all things"
        );
        assert_eq!(seen(Conditioning::None), [(0b11, 0, vec![0, 0], vec![0, 1])]);
    }

    #[test]
    fn without_subtasks_only_the_end_of_the_episode_cuts_a_record() {
        let mut world = World::with(Conditioning::None, RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 3.0], |world| world.allocation[0] = 1);
        world.step([1, 2], [1.0, 3.0], |world| world.street.sites[0].1 = false);
        world.decide();
        assert_eq!(world.replay.len(), 0, "neither another team nor a closed site");
        world.step([1, 2], [1.0, 3.0], nothing);
        world.decide();
        assert_eq!(world.records(), [(10.0 + 5.0 + 2.5, 0.125, 2)], "the team's rewards");
        world.end(true);
        assert_eq!(world.records()[1..], [(10.0 + 5.0, 0.25, 2), (10.0, 0.5, 2)]);
        world.step([1, 2], [1.0, 3.0], nothing);
        world.end(false);
        assert_eq!(world.records()[3], (10.0, 0.0, 2));
    }

    #[test]
    fn without_subtasks_the_nearest_open_site_shapes() {
        let returns = Returns { steps: 1, shaping: 0.5, ..RETURNS };
        let mut world = World::with(Conditioning::None, returns, [1, 1]);
        // Both agents are three doors from the first site, eight from the second.
        world.step([1, 0], [1.0, 0.0], |world| {
            world.street.agents[0] += 1;
            world.street.sites[0].1 = false;
        });
        world.decide();
        assert_eq!(world.records(), [(10.0 + 0.5 * -(0.5 * 7.0 + 0.5 * 8.0) + 3.0, 0.5, 2)]);
    }
}
