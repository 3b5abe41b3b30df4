//! Laws that hold in every state and episode.

use sortie_envs::group_matching::{GroupMatching, Parameters, RIGHT, STAY, walk};
use sortie_envs::random::generator;
use sortie_envs::{Environment, StepError};

use super::{for_random_states, ring};

#[test]
fn states_stay_within_the_rules() {
    for_random_states(20, |world, label| {
        let (ring, parameters) = (world.ring(0), world.parameters());
        assert!(ring.cells.iter().all(|cell| usize::from(*cell) < parameters.cells), "{label}");
        assert_eq!(ring.groups().len(), parameters.groups);
        let covered = ring.groups().fold(0, |covered, members| covered | members);
        assert_eq!(covered, u128::MAX >> (128 - parameters.agents), "{label}");
        let metrics = world.metrics(0);
        assert_eq!(metrics.matches, ring.matches(), "{label}");
        assert!(metrics.matches <= parameters.groups && metrics.steps <= 50, "{label}");
    });
}

#[test]
fn a_group_is_matched_where_one_cell_holds_all_its_members() {
    for_random_states(20, |world, label| {
        let ring = world.ring(0);
        for members in ring.groups() {
            let inside = |cell: usize| {
                let here = |agent: &usize| usize::from(ring.cells[*agent]) == cell;
                (0..ring.cells.len()).filter(here).filter(|agent| members >> agent & 1 == 1).count()
            };
            let most = (0..world.parameters().cells).map(inside).max().unwrap_or(0);
            let gathered = most == members.count_ones() as usize;
            assert_eq!(ring.is_matched(members), gathered, "{label}");
        }
    });
}

#[test]
fn the_return_is_the_steps_and_the_groups_that_gathered() {
    let mut first = 0.0;
    for_random_states(20, |world, label| {
        let metrics = world.metrics(0);
        if metrics.steps == 0 {
            first = metrics.matches as f64;
            assert_eq!(metrics.episode_return, 0.0);
        }
        let want = -0.1 * f64::from(metrics.steps) + 2.5 * (metrics.matches as f64 - first);
        assert!((metrics.episode_return - want).abs() < 1e-9, "{label}");
    });
}

/// The dissertation's ring without noise.
fn still() -> GroupMatching {
    GroupMatching::new(Parameters { noise: 0.0, ..Parameters::default() }, 1).unwrap()
}

#[test]
fn three_steps_are_enough_on_the_shorter_way() {
    let (mut world, mut random) = (still(), generator(3));
    for episode in 0..500 {
        world.reset(0, &mut random);
        let mut actions = [STAY; 8];
        while !world.is_done(0) {
            walk(world.parameters(), world.ring(0), &mut actions);
            world.step(0, &actions, &mut random).unwrap();
        }
        let metrics = world.metrics(0);
        assert!(metrics.solved && metrics.steps <= 3, "episode {episode}: {metrics:?}");
    }
}

#[test]
fn walking_around_together_changes_no_group() {
    let (mut world, mut random) = (still(), generator(4));
    let mut steps = 0;
    for _ in 0..50 {
        world.reset(0, &mut random);
        let matches = world.metrics(0).matches;
        while !world.is_done(0) {
            let outcome = world.step(0, &[RIGHT; 8], &mut random).unwrap();
            assert_eq!((outcome.reward, world.metrics(0).matches), (-0.1, matches));
            steps += 1;
        }
    }
    assert!(steps > 1000);
}

#[test]
fn an_episode_that_is_solved_on_its_last_step_is_continued_in_thought() {
    let parameters =
        Parameters { agents: 2, episode_limit: 1, noise: 0.0, ..Parameters::default() };
    let mut world = GroupMatching::new(parameters, 1).unwrap();
    let (mut random, mut solved) = (generator(9), 0);
    for _ in 0..50 {
        world.reset(0, &mut random);
        assert!(!world.is_done(0), "a start may be solved: the first step decides");
        let step = world.step_executed(0, &[STAY; 2]).unwrap();
        assert!(step.timed_out && step.done() && !step.terminated);
        solved += u32::from(world.metrics(0).solved);
    }
    assert!(solved > 0);
}

#[test]
fn groups_are_as_large_as_the_rules_draw_them() {
    let (mut world, mut random) = (ring("8x6x2"), generator(5));
    let mut sizes = [0; 9];
    for _ in 0..8000 {
        world.reset(0, &mut random);
        sizes[world.ring(0).groups().next().unwrap().count_ones() as usize] += 1;
    }
    assert_eq!(sizes[8], 0, "the second group is never empty");
    assert!(sizes[..8].iter().all(|count| (850..1150).contains(count)), "{sizes:?}");
}

#[test]
fn fixed_groups_are_even_shares() {
    for (set, sizes) in
        [("8x6x2-fixed", &[4, 4][..]), ("7x6x2-fixed", &[4, 3]), ("5x6x2-fixed", &[2, 3])]
    {
        let mut world = ring(set);
        world.reset(0, &mut generator(1));
        let mut start = 0;
        for (members, size) in world.ring(0).groups().zip(sizes) {
            assert_eq!(members, ((1 << size) - 1) << start, "{set}");
            start += size;
        }
    }
}

#[test]
fn noise_replaces_as_many_actions_as_it_says() {
    for (noise, share) in [(0.0, 0.0), (0.1, 0.1 * 2.0 / 3.0), (1.0, 2.0 / 3.0)] {
        let parameters = Parameters { noise, ..Parameters::default() };
        let mut world = GroupMatching::new(parameters, 1).unwrap();
        let (mut random, mut moved, mut asked) = (generator(6), 0, 0);
        while asked < 40_000 {
            world.reset(0, &mut random);
            while !world.is_done(0) {
                let before = world.ring(0).cells.to_vec();
                world.step(0, &[STAY; 8], &mut random).unwrap();
                let pairs = before.iter().zip(world.ring(0).cells);
                moved += pairs.filter(|(before, after)| before != after).count();
                asked += 8;
            }
        }
        let got = moved as f64 / f64::from(asked);
        assert!((got - share).abs() < 0.02, "{noise}: {got}");
    }
}

#[test]
fn steps_that_cannot_be_taken_leave_the_ring_as_it_was() {
    let (mut world, mut random) = (ring("8x6x2"), generator(7));
    world.reset(0, &mut random);
    let (mut before, mut after) = (Vec::new(), Vec::new());
    world.save(0, &mut before);
    let refused = world.step(0, &[0, 0, 0, 3, 0, 0, 0, 0], &mut random);
    assert_eq!(refused, Err(StepError::Unavailable { agent: 3, action: 3 }));
    let refused = world.step(0, &[0; 7], &mut random);
    assert_eq!(refused, Err(StepError::TooFewActions { agents: 8, actions: 7 }));
    world.save(0, &mut after);
    assert_eq!(before, after);
    while !world.is_done(0) {
        world.step(0, &[STAY; 8], &mut random).unwrap();
    }
    assert_eq!(world.step(0, &[STAY; 8], &mut random), Err(StepError::EpisodeOver));
}

#[test]
fn instances_do_not_disturb_each_other() {
    let mut world = GroupMatching::new(Parameters::default(), 3).unwrap();
    let mut random = generator(8);
    (0..3).for_each(|instance| world.reset(instance, &mut random));
    let states = |world: &GroupMatching| {
        [0, 2].map(|instance| {
            let mut bytes = Vec::new();
            world.save(instance, &mut bytes);
            bytes
        })
    };
    let before = states(&world);
    world.step(1, &[RIGHT; 8], &mut random).unwrap();
    world.reset(1, &mut random);
    assert_eq!(states(&world), before);
}
