//! The rules, one by one.

use sortie_envs::Environment;
use sortie_envs::gridworld::{Gridworld, Normals, Rules, Task};
use sortie_envs::random::generator;

use super::{Certain, places, room};

const UP: u16 = 0;
const DOWN: u16 = 1;
const LEFT: u16 = 2;
const RIGHT: u16 = 3;
const STAY: u16 = 4;

/// Takes a step without chance; returns what the team earns.
fn step(world: &mut Gridworld, actions: &[u16]) -> f64 {
    world.step_with(0, actions, &mut Certain::default()).unwrap().reward
}

#[test]
fn every_step_costs_the_same_and_walls_stop() {
    let mut world = room(&[(1, 1, '1'), (5, 5, '2'), (9, 9, 'A')], &[Task::All], 2);
    for (actions, want) in [
        ([UP, UP], [(1, 1), (4, 5)]),
        ([LEFT, LEFT], [(1, 1), (4, 4)]),
        ([DOWN, RIGHT], [(2, 1), (4, 5)]),
        ([STAY, DOWN], [(2, 1), (5, 5)]),
    ] {
        assert_eq!(step(&mut world, &actions), -0.2);
        assert_eq!(places(&world), want);
    }
}

#[test]
fn of_two_in_one_cell_the_one_that_came_goes_back() {
    let start = || room(&[(5, 5, '1'), (5, 7, '2'), (9, 9, 'A')], &[Task::All], 2);
    let mut world = start();
    step(&mut world, &[STAY, LEFT]);
    step(&mut world, &[STAY, LEFT]);
    assert_eq!(places(&world), [(5, 5), (5, 6)]);
    step(&mut world, &[RIGHT, STAY]);
    assert_eq!(places(&world), [(5, 5), (5, 6)]);
    step(&mut world, &[RIGHT, LEFT]);
    assert_eq!(places(&world), [(5, 6), (5, 5)], "they may swap");
    for first_goes_back in [false, true] {
        let mut world = start();
        let mut chance = Certain { first_goes_back, ..Certain::default() };
        world.step_with(0, &[RIGHT, LEFT], &mut chance).unwrap();
        let want = if first_goes_back { [(5, 5), (5, 6)] } else { [(5, 6), (5, 7)] };
        assert_eq!(places(&world), want);
    }
}

#[test]
fn an_open_pit_sends_to_the_start() {
    let mut world = room(&[(5, 5, '1'), (9, 9, '2'), (5, 7, '!'), (1, 1, 'A')], &[Task::All], 2);
    let mut chance = Certain { open: vec![0], ..Certain::default() };
    world.step_with(0, &[RIGHT, STAY], &mut chance).unwrap();
    assert_eq!(places(&world)[0], (5, 6));
    world.step_with(0, &[RIGHT, STAY], &mut chance).unwrap();
    assert_eq!(places(&world)[0], (5, 5));
    step(&mut world, &[RIGHT, STAY]);
    step(&mut world, &[RIGHT, STAY]);
    assert_eq!(places(&world)[0], (5, 7));
    // It was last open in step 2, and has grown twice by what task 1 has it grow by.
    let pit = world.pits(0)[0];
    assert_eq!((pit.probability, pit.ticks, pit.is_open), (0.1, 4, false));
}

#[test]
fn in_task_1_each_treasure_counts_once() {
    let things = [(5, 5, '1'), (5, 7, '2'), (4, 5, 'A'), (4, 7, 'B')];
    let mut world = room(&things, &[Task::All], 2);
    assert_eq!(step(&mut world, &[UP, STAY]), 9.8);
    step(&mut world, &[RIGHT, LEFT]);
    step(&mut world, &[STAY, UP]);
    assert_eq!(step(&mut world, &[STAY, LEFT]), -0.2, "it is gone");
    assert_eq!(world.found(0), [1, 0]);
    assert!(step(&mut world, &[RIGHT, STAY]) > 9.0);
    assert_eq!((world.found(0), world.tiers(0)), (&[3, 0][..], 1));
    let episode = world.episode(0);
    assert_eq!((episode.solved, episode.metrics), (true, vec![Some(2.0), Some(1.0)]));
}

#[test]
fn in_task_2_the_first_treasure_counts_once_for_each() {
    let things = [(5, 5, '1'), (5, 7, '2'), (4, 5, 'A'), (4, 7, 'B')];
    let mut world = room(&things, &[Task::Same], 2);
    assert_eq!(step(&mut world, &[UP, UP]), 9.8, "the other treasure does not count");
    assert_eq!(world.found(0), [1, 0]);
    assert_eq!(step(&mut world, &[STAY, LEFT]), -0.2);
    assert_eq!(step(&mut world, &[DOWN, LEFT]), 9.8);
    assert_eq!((world.found(0), world.tiers(0)), (&[1, 1][..], 1));
}

#[test]
fn in_task_3_each_agent_has_its_own_treasure() {
    let things = [(5, 5, '1'), (5, 7, '2'), (4, 5, 'B'), (4, 7, 'A')];
    let mut world = room(&things, &[Task::Own], 2);
    assert_eq!(step(&mut world, &[UP, UP]), -0.2);
    assert_eq!(step(&mut world, &[RIGHT, LEFT]), -0.2);
    // Both want the cell between; the second goes back.
    step(&mut world, &[UP, LEFT]);
    step(&mut world, &[RIGHT, LEFT]);
    assert_eq!(world.found(0), [0, 2]);
    assert_eq!(world.tiers(0), 0);
    assert_eq!(step(&mut world, &[DOWN, STAY]), 9.8);
    assert_eq!(world.tiers(0), 1);
}

#[test]
fn a_finished_tier_opens_doors_and_pits_change() {
    let things = [
        (5, 5, '1'),
        (9, 9, '2'),
        (4, 5, 'A'),
        (3, 9, 'B'),
        (5, 6, '$'),
        (15, 15, 'C'),
        (16, 15, 'D'),
        (18, 18, '!'),
    ];
    let mut world = room(&things, &[Task::Same, Task::All], 2);
    step(&mut world, &[RIGHT, UP]);
    assert_eq!(places(&world)[0], (5, 5), "the door is shut");
    step(&mut world, &[UP, UP]);
    (0..4).for_each(|_| assert_eq!(step(&mut world, &[STAY, UP]), -0.2));
    assert_eq!((world.found(0), world.tiers(0)), (&[1, 0][..], 0), "B does not count");
    step(&mut world, &[DOWN, LEFT]);
    (0..3).for_each(|_| assert_eq!(step(&mut world, &[STAY, LEFT]), -0.2));
    step(&mut world, &[STAY, DOWN]);
    assert_eq!((world.found(0), world.tiers(0)), (&[1, 1][..], 1));
    step(&mut world, &[RIGHT, STAY]);
    assert_eq!(places(&world)[0], (5, 6));
    // Eleven steps of the first tier, one of the second.
    world.settle(0, &mut Certain::default());
    let grown = world.pits(0)[0].probability;
    assert!((grown - (11.0 * 0.005 + 0.05)).abs() < 1e-12, "{grown}");
}

#[test]
fn normal_numbers_are_normal() {
    let normals = Normals::new();
    let all = || (0..Normals::COUNT).map(|place| normals.at(place));
    let mean = |power: i32| all().map(|it| it.powi(power)).sum::<f64>() / Normals::COUNT as f64;
    for (power, want, tolerance) in [(1, 0.0, 1e-6), (2, 1.0, 2e-3), (3, 0.0, 1e-5), (4, 3.0, 0.04)]
    {
        assert!((mean(power) - want).abs() < tolerance, "{power}: {}", mean(power));
    }
    let below = all().filter(|it| *it < 1.0).count() as f64 / Normals::COUNT as f64;
    assert!((below - 0.841_345).abs() < 3e-4, "{below}");
}

#[test]
fn actions_are_replaced_as_often_as_they_should() {
    // Where nobody but chance moves it, and nothing is near, an agent leaves its cell in four of five replaced actions.
    let rules =
        Rules { noise: 0.25, ..room(&[(9, 9, '1'), (1, 1, 'A')], &[Task::All], 1).rules().clone() };
    let (mut world, mut random) = (Gridworld::new(rules, 1), generator(1));
    let moves = (0..80_000).filter(|_| {
        world.start(0);
        world.step(0, &[STAY], &mut random).unwrap();
        places(&world)[0] != (9, 9)
    });
    let share = moves.count() as f64 / 80_000.0;
    assert!((share - 0.2).abs() < 0.005, "{share}");
}

#[test]
fn pits_open_once_in_so_many_steps() {
    for (tasks, want) in [([Task::All], 0.152), ([Task::Own], 0.053)] {
        let mut world = room(&[(9, 8, '1'), (1, 1, 'A'), (9, 9, '!')], &tasks, 1);
        let (mut random, mut opened) = (generator(1), 0);
        for _ in 0..200 {
            world.start(0);
            for _ in 0..400 {
                // It sees the pit, and does not step on it.
                world.step(0, &[STAY], &mut random).unwrap();
                opened += u32::from(world.pits(0)[0].is_open);
            }
        }
        let share = f64::from(opened) / f64::from(200 * 400);
        assert!((share - want).abs() < 0.004, "{tasks:?}: {share}");
    }
}
