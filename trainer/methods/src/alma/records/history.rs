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

fn tasks(set: u32) -> impl Iterator<Item = usize> {
    members(set.into())
}

#[cfg(test)]
mod tests;
