use sortie_envs::random::generator;
use sortie_envs::{Environment, Step, UNASSIGNED};

use super::*;
use crate::alma::agents::NO_ACTION;
use crate::alma::records::tests::toy::{AGENTS, Street, Toy, toy};
use crate::alma::records::tests::usual;

/// Two agents at door 7; two sites, at doors 4 and 15.
struct World {
    environment: Toy,
    street: Street,
    allocation: Vec<u8>,
    before: Vec<u8>,
    last_actions: Vec<u8>,
    replay: Replay,
}

impl World {
    fn new(shaping: f32, allocation: [u8; 2]) -> Self {
        Self::with(Conditioning::Mask, (3, shaping), allocation)
    }

    /// Rewards of so many steps, so shaped, are worth half as much a step later.
    fn with(conditioning: Conditioning, (steps, shaping): (u32, f32), allocation: [u8; 2]) -> Self {
        let environment = toy();
        let mut everybody = vec![UNASSIGNED; AGENTS];
        everybody[..2].copy_from_slice(&allocation);
        let mut config = usual();
        config.environment.instances = 1;
        config.network.subtask = conditioning;
        config.returns = ReturnsConfig { steps, discount: 0.5, shaping };
        config.replay.capacity = 100;
        Self {
            street: Street { agents: vec![7; 2], ..Street::new(2, &[4, 15]) },
            allocation: everybody,
            before: Vec::new(),
            last_actions: vec![NO_ACTION; AGENTS],
            replay: Replay::new(&config, environment.spec()),
            environment,
        }
    }

    /// A step in which each site's task earns its reward, and the team ten times as much as nothing.
    fn step(&mut self, rewards: [f64; 2], change: impl FnOnce(&mut Self)) {
        self.leave(rewards, Step::default(), change);
    }

    fn leave(&mut self, rewards: [f64; 2], step: Step, change: impl FnOnce(&mut Self)) {
        let (state, seen) = (self.street.bytes(), self.street.seen());
        let (allocation, last_actions) = (self.allocation.clone(), self.last_actions.clone());
        change(self);
        let actions = [1, 2, 0, 0, 0, 0, 0, 0];
        let next = self.street.bytes();
        let transition = Transition {
            environment: &self.environment,
            instance: 0,
            state: &state,
            actions: &actions,
            step: Step { reward: 10.0, ..step },
            task_rewards: &[rewards[0], rewards[1], 0.0, 0.0],
            agent_rewards: &[],
            next: &next,
        };
        let moment = Moment {
            state: &state,
            allocation: &allocation,
            last_actions: &last_actions,
            actions: &actions.map(|action| action as u8),
        };
        let seen = (&seen, self.street.seen().open_tasks as u32);
        self.replay.push(&transition, seen, (moment, &self.before));
        self.before = allocation;
        self.last_actions.iter_mut().zip(actions).for_each(|(last, action)| *last = action as u8);
    }

    /// Two steps that earn nothing, so that those before them have been followed by some.
    fn go_on(&mut self) {
        (0..2).for_each(|_| self.step([0.0; 2], nothing));
    }

    fn end(&mut self, timed_out: bool) {
        let step = Step { timed_out, terminated: !timed_out, ..Step::default() };
        self.leave([0.0; 2], step, nothing);
    }

    fn place(&self, step: usize) -> Place {
        self.replay.steps.oldest(0).after(step)
    }

    fn sample(&self, step: usize, task: u8) -> Sample<'_> {
        self.replay.sample((self.place(step), task))
    }

    /// Reward, discount and size of the team of a sample, and how many steps later the next state is.
    fn found(&self, step: usize, task: u8) -> (f32, f32, usize, usize) {
        let Sample { reward, discount, now, task, .. } = self.sample(step, task);
        let next = self.replay.future(self.place(step), task).place;
        (reward, discount, now.team(task).count_ones() as usize, next.since(self.place(step)))
    }

    /// The subtasks of a state that are samples.
    fn samples(&self, step: usize) -> u32 {
        self.replay.steps.note(self.place(step)).samples
    }
}

fn nothing(_: &mut World) {}

#[test]
fn a_sample_sums_three_steps_and_bootstraps() {
    let mut world = World::new(0.0, [0, 0]);
    for reward in [1.0, 2.0, 4.0, 99.0] {
        world.step([reward, 99.0], |world| world.street.agents[0] += 1);
    }
    assert_eq!(world.samples(0), 0b1, "the other site has no team");
    assert_eq!(world.found(0, 0), (1.0 + 1.0 + 1.0, 0.125, 2, 3));
    let Sample { now, things, next, .. } = world.sample(0, 0);
    assert_eq!((now.state[1], next.state[1], &now.actions[..2]), (7, 10, &[1, 2][..]));
    assert_eq!(things, 1 << AGENTS);
    assert_eq!((now.last_actions[0], next.last_actions[..2].to_vec()), (NO_ACTION, vec![1, 2]));
    assert_eq!(now.allocation, world.allocation);
}

#[test]
fn another_team_ends_a_sample_which_bootstraps_with_the_old_team() {
    let mut world = World::new(0.0, [0, 1]);
    world.step([1.0, 3.0], |world| world.allocation[..2].copy_from_slice(&[0, 0]));
    (0..3).for_each(|_| world.step([1.0, 3.0], nothing));
    world.go_on();
    // Both sites have another team: the first gained an agent, the second lost its only one.
    assert_eq!(world.found(0, 0), (1.0, 0.5, 1, 1));
    assert_eq!(world.found(0, 1), (3.0, 0.5, 1, 1));
    assert_eq!([0, 1].map(|task| world.sample(0, task).things), [1 << AGENTS, 2 << AGENTS]);
    assert_eq!(world.found(1, 0), (1.75, 0.125, 2, 3), "the same team goes on");
}

#[test]
fn a_closed_site_ends_its_samples_without_bootstrapping() {
    let mut world = World::new(0.0, [0, 1]);
    world.step([1.0, 0.0], nothing);
    world.step([8.0, 0.0], |world| world.street.sites[0].1 = false);
    world.step([5.0, 0.0], nothing);
    assert_eq!(world.found(0, 0).0, 1.0 + 4.0);
    assert_eq!((world.found(0, 0).1, world.found(1, 0).1), (0.0, 0.0));
    // A site without open work is no sample.
    assert_eq!([0, 1, 2].map(|step| world.samples(step)), [0b11, 0b11, 0b10]);
}

#[test]
fn a_timeout_bootstraps_from_the_final_state_and_an_end_does_not() {
    for (timed_out, discount) in [(true, 0.25), (false, 0.0)] {
        let mut world = World::new(0.0, [0, 0]);
        world.step([1.0, 0.0], |world| world.street.agents[1] = 5);
        world.end(timed_out);
        world.before.clear();
        world.step([7.0, 0.0], nothing);
        let (reward, found, ..) = world.found(0, 0);
        assert_eq!((reward, found), (1.0, discount));
        if timed_out {
            let next = world.sample(0, 0).next;
            assert_eq!((next.state[2], next.last_actions[..2].to_vec()), (5, vec![1, 2]));
            assert_eq!(next.allocation, world.allocation);
        }
        assert_eq!(world.samples(2), 0, "nobody acts in the final state");
    }
}

#[test]
fn shaping_adds_the_difference_of_potentials() {
    for steps in [1, 3] {
        let mut world = World::with(Conditioning::Mask, (steps, 0.5), [0, 0]);
        // Both are three doors away before, one of them two after.
        world.step([1.0, 0.0], |world| {
            world.street.agents[0] -= 1;
            world.allocation[1] = 1;
        });
        (0..3).for_each(|_| world.step([0.0, 0.0], nothing));
        let (reward, discount, ..) = world.found(0, 0);
        assert_eq!((reward, discount), (1.0 + 0.5 * -2.5 + 3.0, 0.5), "of the old team");
    }
    let mut world = World::with(Conditioning::Mask, (1, 0.5), [0, 0]);
    world.step([1.0, 0.0], |world| world.street.sites[0].1 = false);
    world.go_on();
    assert_eq!(world.found(0, 0).0, 1.0 + 3.0, "no later potential at the end");
    let mut world = World::with(Conditioning::Mask, (1, 0.5), [0, 0]);
    world.end(false);
    assert_eq!(world.found(0, 0).0, 3.0, "nor where the episode is over");
    let mut world = World::with(Conditioning::Mask, (3, 0.5), [0, 0]);
    for _ in 0..4 {
        world.step([0.0, 0.0], |world| world.street.agents[0] -= 1);
    }
    // Three doors nearer after three steps, what is between them cancels.
    assert_eq!(world.found(0, 0).0, 3.0 - 0.125 * 1.5);
}

#[test]
fn without_subtasks_only_the_end_of_the_episode_cuts_a_sample() {
    let mut world = World::with(Conditioning::None, (3, 0.0), [0, 1]);
    world.step([1.0, 3.0], |world| world.allocation[0] = 1);
    world.step([1.0, 3.0], |world| world.street.sites[0].1 = false);
    world.step([1.0, 3.0], nothing);
    world.step([1.0, 3.0], nothing);
    assert_eq!(world.found(0, 0), (10.0 + 5.0 + 2.5, 0.125, 2, 3), "the team's rewards");
    assert_eq!(world.samples(0), 1);
    world.end(true);
    assert_eq!(world.found(3, 0), (10.0 + 5.0, 0.25, 2, 2));
    let mut world = World::with(Conditioning::None, (3, 0.0), [0, 1]);
    world.end(false);
    assert_eq!(world.found(0, 0).1, 0.0);
}

#[test]
fn without_subtasks_the_nearest_open_site_shapes() {
    let mut world = World::with(Conditioning::None, (1, 0.5), [1, 1]);
    // Both agents are three doors from the first site, eight from the second.
    world.step([1.0, 0.0], |world| {
        world.street.agents[0] += 1;
        world.street.sites[0].1 = false;
    });
    world.go_on();
    let want = 10.0 + 0.5 * -(0.5 * 7.0 + 0.5 * 8.0) + 3.0;
    assert_eq!(world.found(0, 0), (want, 0.5, 2, 1));
}

#[test]
fn every_sample_is_drawn_as_often_and_the_oldest_are_forgotten() {
    let mut world = World::new(0.0, [0, 1]);
    // States of two samples and of one take turns.
    for step in 0..200 {
        world.step([f64::from(step), 0.0], |world| world.allocation[1] = (step % 2) as u8);
    }
    let Replay { samples, steps, .. } = &world.replay;
    assert!((99..=100).contains(&samples[0]) && world.replay.has(99) && !world.replay.has(101));
    assert!((66..=67).contains(&steps.states()), "one and a half a state");
    let mut random = generator(1);
    let mut drawn = std::collections::BTreeMap::<_, i32>::new();
    let mut some = Vec::new();
    for _ in 0..100 {
        world.replay.draw(100, &mut random, &mut some);
        assert_eq!(some.len(), 100);
        some.iter().for_each(|sample| *drawn.entry(*sample).or_default() += 1);
    }
    // Three states have not been followed by as many yet.
    assert!((92..=96).contains(&drawn.len()), "{}", drawn.len());
    assert!(drawn.values().all(|count| (60..160).contains(count)), "{drawn:?}");
    assert!(drawn.keys().all(|(place, _)| steps.has(*place)));
}

#[test]
fn where_nobody_has_a_subtask_nothing_is_drawn() {
    let mut world = World::new(0.0, [UNASSIGNED; 2]);
    (0..20).for_each(|_| world.step([1.0; 2], nothing));
    let mut drawn = Vec::new();
    world.replay.draw(5, &mut generator(1), &mut drawn);
    assert!(!world.replay.has(1) && drawn.is_empty());
}
