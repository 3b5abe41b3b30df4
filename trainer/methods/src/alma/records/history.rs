//! Turns the steps of one episode into records with n-step returns.
//!
//! A record of step t and building b sums the rewards of b for up to n steps. It ends earlier, and
//! bootstraps with the team of step t, when b gets another team; without bootstrapping when b is
//! complete or burned down. A time-out bootstraps from the final state.
//!
//! Without subtasks there is one record for each step: everybody is its team, its rewards are the whole
//! team's, and only the end of the episode cuts it.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{AgentState, BuildingState, City, potential};

use super::conditioning::Conditioning;
use super::replay::{AgentStep, BuildingStep, Record, Replay};

/// How rewards of several steps become one target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Returns {
    /// Steps n after which a record bootstraps.
    pub steps: u32,
    /// Discount per step.
    pub discount: f32,
    /// Potential of one cell between an agent and its building; 0 leaves the rewards alone.
    pub shaping: f32,
}

/// Rewards of one step.
#[derive(Clone, Copy, Debug)]
pub struct StepRewards<'a> {
    /// Reward of every building's task.
    pub tasks: &'a [f64],
    /// Reward of the whole team.
    pub team: f64,
}

/// A state with what was decided in it.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Agents and buildings.
    pub city: City<'a>,
    /// The building of every agent.
    pub allocation: &'a [u8],
    /// The last action of every agent.
    pub last_actions: &'a [u8],
}

/// A past step whose records are not all complete.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Frame {
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    actions: Vec<u8>,
    /// Rewards of each task since this step, discounted.
    returns: Vec<f32>,
    /// Discount to the power of the steps since.
    weight: f32,
    steps: u32,
    /// Tasks, as bits, whose record is incomplete.
    pending: u32,
}

impl Frame {
    fn city(&self) -> City<'_> {
        City { agents: &self.agents, buildings: &self.buildings }
    }

    fn team(&self, task: usize) -> impl Iterator<Item = usize> + Clone + '_ {
        let member = move |building: &u8| usize::from(*building) == task;
        (0..self.agents.len()).filter(move |agent| member(&self.allocation[*agent]))
    }

    fn same_team(&self, task: usize, allocation: &[u8]) -> bool {
        let at = |building: u8| usize::from(building) == task;
        let count = self.agents.len();
        self.allocation[..count].iter().zip(allocation).all(|(a, b)| at(*a) == at(*b))
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

    /// Completes records whose n steps are over or whose building has another team now.
    ///
    /// Call it once an allocation is in force and before the actions of the step.
    pub fn decide(&mut self, now: Moment<'_>, replay: &mut Replay) {
        let rules = self.rules;
        for frame in &mut self.frames {
            for task in bits(frame.pending) {
                let same_team =
                    !rules.conditioning.has_subtasks() || frame.same_team(task, now.allocation);
                if frame.steps >= rules.returns.steps || !same_team {
                    rules.complete(frame, task, now, frame.weight, replay);
                }
            }
        }
        self.drop_complete();
    }

    /// Notes what the agents do in the state that [`decide`](Self::decide) saw.
    pub fn act(&mut self, now: Moment<'_>, actions: &[u16]) {
        let count = now.city.agents.len();
        let mut frame = self.spare.pop().unwrap_or_default();
        copy(&mut frame.agents, now.city.agents);
        copy(&mut frame.buildings, now.city.buildings);
        copy(&mut frame.allocation, &now.allocation[..count]);
        if !self.rules.conditioning.has_subtasks() {
            frame.allocation.fill(WHOLE as u8);
        }
        copy(&mut frame.last_actions, &now.last_actions[..count]);
        frame.actions.clear();
        frame.actions.extend(actions[..count].iter().map(|action| *action as u8));
        frame.returns.clear();
        frame.returns.resize(now.city.buildings.len(), 0.0);
        frame.weight = 1.0;
        frame.steps = 0;
        frame.pending = 0;
        for task in bits(self.rules.open_tasks(now.city)) {
            let has_team = frame.team(task).next().is_some();
            frame.pending |= u32::from(has_team) << task;
        }
        self.frames.push_back(frame);
    }

    /// Adds the rewards of the step just taken and completes the records of closed buildings.
    pub fn reward(&mut self, after: Moment<'_>, rewards: StepRewards<'_>, replay: &mut Replay) {
        let rules = self.rules;
        let open = rules.open_tasks(after.city);
        for frame in &mut self.frames {
            for task in bits(frame.pending) {
                let reward = if rules.conditioning.has_subtasks() {
                    rewards.tasks[task]
                } else {
                    rewards.team
                };
                frame.returns[task] += frame.weight * reward as f32;
            }
            frame.weight *= rules.returns.discount;
            frame.steps += 1;
            for task in bits(frame.pending & !open) {
                rules.complete(frame, task, after, 0.0, replay);
            }
        }
        self.drop_complete();
    }

    /// Ends the episode: what is incomplete bootstraps after a time-out and is worth nothing after an end.
    pub fn end(&mut self, after: Moment<'_>, timed_out: bool, replay: &mut Replay) {
        for frame in &mut self.frames {
            let discount = if timed_out { frame.weight } else { 0.0 };
            for task in bits(frame.pending) {
                self.rules.complete(frame, task, after, discount, replay);
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
    fn open_tasks(self, city: City<'_>) -> u32 {
        if self.conditioning.has_subtasks() { city.open_tasks() } else { 1 << WHOLE }
    }

    /// Stores the record of one task and takes it off the frame's list.
    ///
    /// `discount` is the factor of the value of the state after it.
    fn complete(
        self,
        frame: &mut Frame,
        task: usize,
        after: Moment<'_>,
        discount: f32,
        replay: &mut Replay,
    ) {
        frame.pending &= !(1 << task);
        let agent_step = |agent: usize| AgentStep {
            agent: frame.agents[agent],
            last_action: frame.last_actions[agent],
            action: frame.actions[agent],
            next: after.city.agents[agent],
            next_last_action: after.last_actions[agent],
            task: frame.allocation[agent],
        };
        let building_step = |building: usize| BuildingStep {
            building: frame.buildings[building],
            next: after.city.buildings[building],
        };
        let before = self.potential(frame, task, frame.city());
        let later = self.potential(frame, task, after.city);
        let reward = frame.returns[task] + discount * later - before;

        let team = frame.team(task);
        let record = Record::new(reward, discount, team.clone().count());
        let masked = self.conditioning == Conditioning::Mask;
        let others = (0..frame.agents.len())
            .filter(|agent| !masked && usize::from(frame.allocation[*agent]) != task);
        let buildings = if masked { task..task + 1 } else { 0..frame.buildings.len() };
        replay.push(record, team.chain(others).map(agent_step), buildings.map(building_step));
    }

    /// Potential of a state for the team that a frame has at a task.
    fn potential(self, frame: &Frame, task: usize, city: City<'_>) -> f32 {
        let task_of_team = self.conditioning.has_subtasks().then_some(task);
        potential(self.returns.shaping, city, frame.team(task), task_of_team)
    }
}

fn copy<T: Copy>(to: &mut Vec<T>, from: &[T]) {
    to.clear();
    to.extend_from_slice(from);
}

/// Positions of the set bits.
fn bits(mask: u32) -> impl Iterator<Item = usize> {
    (0..32).filter(move |bit| mask >> bit & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::super::replay::RecordLayout;
    use super::*;
    use sortie_envs::save_the_city::{AgentKind, BuildingKind, Status};

    const RETURNS: Returns = Returns { steps: 3, discount: 0.5, shaping: 0.0 };

    /// Two agents in a row at some x; two buildings, the second far away.
    struct World {
        agents: Vec<AgentState>,
        buildings: Vec<BuildingState>,
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
            let masked = conditioning == Conditioning::Mask;
            let layout = RecordLayout { agents: 2, buildings: if masked { 1 } else { 2 } };
            let building = |x| BuildingState {
                health: 0.5,
                fire: 0.0,
                period: 70,
                to_next_fire: 60,
                since_last_fire: 10,
                kind: BuildingKind::Fast,
                status: Status::Open,
                x,
                y: 4,
            };
            Self {
                agents: vec![AgentState::at(AgentKind::Builder, 4, 7); 2],
                buildings: vec![building(4), building(13)],
                allocation: allocation.to_vec(),
                last_actions: vec![9; 2],
                history: History::new(conditioning, returns),
                replay: Replay::new(100, layout),
            }
        }

        /// One step in which each building's task earns its reward.
        fn step(&mut self, actions: [u16; 2], rewards: [f64; 2], change: impl FnOnce(&mut Self)) {
            let Self { agents, buildings, allocation, last_actions, history, replay } = self;
            let city = City { agents, buildings };
            let now = Moment { city, allocation, last_actions };
            history.decide(now, replay);
            history.act(now, &actions);
            self.last_actions = actions.iter().map(|action| *action as u8).collect();
            change(self);
            let Self { agents, buildings, allocation, last_actions, history, replay } = self;
            let after = Moment { city: City { agents, buildings }, allocation, last_actions };
            let rewards = StepRewards { tasks: &rewards, team: 10.0 };
            history.reward(after, rewards, replay);
        }

        fn decide(&mut self) {
            let Self { agents, buildings, allocation, last_actions, history, replay } = self;
            let city = City { agents, buildings };
            history.decide(Moment { city, allocation, last_actions }, replay);
        }

        fn end(&mut self, timed_out: bool) {
            let Self { agents, buildings, allocation, last_actions, history, replay } = self;
            let city = City { agents, buildings };
            history.end(Moment { city, allocation, last_actions }, timed_out, replay);
        }

        /// (reward, discount, team size) of every record.
        fn records(&self) -> Vec<(f32, f32, usize)> {
            let record = |index| {
                let record = self.replay.get(index).record;
                (record.reward, record.discount, record.size.into())
            };
            (0..self.replay.len()).map(record).collect()
        }
    }

    fn nothing(_: &mut World) {}

    #[test]
    fn a_record_sums_three_steps_and_bootstraps() {
        let mut world = World::new(RETURNS, [0, 0]);
        for (action, reward) in [(1, 1.0), (2, 2.0), (3, 4.0)] {
            world.step([action, 0], [reward, 99.0], |world| world.agents[0].y += 1);
            assert_eq!(world.replay.len(), 0);
        }
        world.decide();
        assert_eq!(world.records(), [(1.0 + 1.0 + 1.0, 0.125, 2)]);
        let member = world.replay.get(0).agents[0];
        assert_eq!((member.last_action, member.action, member.next_last_action), (9, 1, 3));
        assert_eq!((member.agent.y, member.next.y), (7, 10));
    }

    #[test]
    fn another_team_ends_a_record_which_bootstraps_with_the_old_team() {
        let mut world = World::new(RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 3.0], nothing);
        world.allocation = vec![0, 0];
        world.decide();
        // Both buildings have another team: the first gained an agent, the second lost its only one.
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
    fn a_closed_building_ends_its_records_without_bootstrapping() {
        let mut world = World::new(RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 0.0], nothing);
        world.step([1, 2], [8.0, 0.0], |world| world.buildings[0].status = Status::Complete);
        assert_eq!(world.records(), [(1.0 + 4.0, 0.0, 1), (8.0, 0.0, 1)]);
        // A building without open work starts no more records.
        world.step([0, 2], [5.0, 0.0], nothing);
        assert_eq!(world.replay.len(), 2);
    }

    #[test]
    fn a_timeout_bootstraps_from_the_final_state_and_an_end_does_not() {
        for (timed_out, discount) in [(true, 0.5), (false, 0.0)] {
            let mut world = World::new(RETURNS, [0, 0]);
            world.step([1, 2], [1.0, 0.0], |world| world.agents[1].x = 5);
            world.end(timed_out);
            assert_eq!(world.records(), [(1.0, discount, 2)]);
            assert!(world.history.frames.is_empty(), "nothing of the episode is kept");
            assert_eq!(world.replay.get(0).agents[1].next.x, 5);
        }
    }

    #[test]
    fn shaping_adds_the_difference_of_potentials() {
        let returns = Returns { steps: 1, shaping: 0.5, ..RETURNS };
        let mut world = World::new(returns, [0, 0]);
        // Distance 3 and 3 before, 2 and 3 after: two and two cells too far, then one and two.
        world.step([3, 0], [1.0, 0.0], |world| world.agents[0].y -= 1);
        world.decide();
        assert_eq!(world.records(), [(1.0 + 0.5 * -1.5 + 2.0, 0.5, 2)]);

        let mut world = World::new(returns, [0, 0]);
        world.step([3, 0], [1.0, 0.0], |world| world.buildings[0].status = Status::BurnedDown);
        assert_eq!(world.records(), [(1.0 + 2.0, 0.0, 2)], "no later potential at the end");
    }

    #[test]
    fn a_record_holds_what_its_team_may_see() {
        let seen = |conditioning| {
            let mut world = World::with(conditioning, RETURNS, [1, 0]);
            world.agents[0].x = 9;
            world.step([1, 2], [1.0, 3.0], |world| world.allocation = vec![1, 1]);
            world.decide();
            world.end(true);
            let record = |index| {
                let sample = world.replay.get(index);
                let agents = sample.agents.iter().map(|step| (step.agent.x, step.task));
                let buildings = sample.buildings.iter().map(|step| step.building.x);
                (agents.collect::<Vec<_>>(), buildings.collect::<Vec<_>>())
            };
            (0..world.replay.len()).map(record).collect::<Vec<_>>()
        };
        assert_eq!(
            seen(Conditioning::Mask),
            [(vec![(4, 0)], vec![4]), (vec![(9, 1)], vec![13])],
            "the team and its building"
        );
        assert_eq!(
            seen(Conditioning::Input),
            [(vec![(4, 0), (9, 1)], vec![4, 13]), (vec![(9, 1), (4, 0)], vec![4, 13])],
            "everything, the team first, with the tasks of the record's own step"
        );
        assert_eq!(seen(Conditioning::None), [(vec![(9, 0), (4, 0)], vec![4, 13])]);
    }

    #[test]
    fn without_subtasks_only_the_end_of_the_episode_cuts_a_record() {
        let mut world = World::with(Conditioning::None, RETURNS, [0, 1]);
        world.step([1, 2], [1.0, 3.0], |world| world.allocation = vec![1, 1]);
        world.step([1, 2], [1.0, 3.0], |world| world.buildings[0].status = Status::Complete);
        world.decide();
        assert_eq!(world.replay.len(), 0, "neither another team nor a closed building");
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
    fn without_subtasks_the_nearest_open_building_shapes() {
        let returns = Returns { steps: 1, shaping: 0.5, ..RETURNS };
        let mut world = World::with(Conditioning::None, returns, [1, 1]);
        // Both agents are three cells from the first building, eleven and twelve from the second.
        world.step([3, 0], [1.0, 0.0], |world| {
            world.agents[0].x += 1;
            world.buildings[0].status = Status::BurnedDown;
        });
        world.decide();
        assert_eq!(world.records(), [(10.0 + 0.5 * -(5.0 + 5.5) + 2.0, 0.5, 2)]);
    }
}
