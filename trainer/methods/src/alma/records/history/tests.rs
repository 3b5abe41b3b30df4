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
