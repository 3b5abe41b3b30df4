//! The sets by their names, the laws of all environments, and what the environment says of itself.

use std::collections::BTreeMap;

use sortie_envs::gridworld::SET_NAMES;
use sortie_envs::random::{Random, generator};
use sortie_envs::registry::Setting;
use sortie_envs::{EntitySet, Observation, Split, View, conformance, open, step_alone};

use super::{opened, saved};

#[test]
fn all_sets_hold_to_the_laws() {
    for set in SET_NAMES {
        assert_eq!(conformance::check(&*opened(set, &[]), 3, 3), Ok(()), "{set}");
    }
}

#[test]
fn the_default_is_the_first_task_of_two_agents() {
    let world = open("gridworld", Split::Train, 3, &BTreeMap::new()).unwrap();
    let spec = world.spec();
    assert_eq!((spec.shape.agents, spec.shape.entities, spec.shape.features), (2, 2, 15));
    assert_eq!((spec.view, world.instances(), spec.episode_limit), (View::Vectors, 3, 500));
    assert_eq!(spec.features[..3], ["wall-right", "wall-down", "wall-left"]);
    let rest = ["found-1", "row", "column", "other-0-rows", "other-0-columns"];
    assert_eq!(spec.features[10..], rest);
    assert_eq!(opened("flip-2", &[]).spec().shape.features, 21);
    assert_eq!(opened("task1-4", &[]).spec().features[19..], ["other-2-rows", "other-2-columns"]);
}

#[test]
fn settings_change_the_rules_and_unknown_ones_are_named() {
    let short = opened("task1-2", &[("episode_limit", Setting::Whole(7))]);
    assert_eq!(short.spec().episode_limit, 7);
    let refused = |set: &str, name: &str, value| {
        let settings = BTreeMap::from([(name.to_owned(), value)]);
        open(&format!("gridworld/{set}"), Split::Train, 1, &settings).err().unwrap().to_string()
    };
    for (name, value, words) in [
        ("noice", Setting::Number(0.5), "unknown field `noice`"),
        ("noise", Setting::Number(1.5), "the noise is not a probability from 0 to 1"),
        ("episode_limit", Setting::Whole(0), "an episode limit of 0 steps leaves no episode"),
    ] {
        let error = refused("task1-2", name, value);
        assert!(error.starts_with(words), "{error}");
    }
    for set in ["task1", "task4-2", "task1-5", "flip-3"] {
        let error = refused(set, "episode_limit", Setting::Whole(7));
        assert!(error.starts_with(&format!("no set `{set}`; there are `task1-2`")), "{error}");
    }
}

/// Episodes of the script that end with everything found, and the mean of their lengths.
fn scripted(set: &str, episodes: u64) -> (usize, f64) {
    let mut world = opened(set, &[]);
    let agents = world.spec().shape.agents;
    let (mut solved, mut steps) = (0, 0);
    for seed in 0..episodes {
        let mut random = generator(seed);
        world.reset(0, &mut random);
        let mut actions = vec![0; agents];
        while !world.episode(0).done {
            let state = saved(&*world);
            assert!(world.scripted(&state, &[], &mut random, &mut actions));
            world.step(0, &actions, &mut random).unwrap();
        }
        solved += usize::from(world.episode(0).solved);
        steps += world.episode(0).steps;
    }
    (solved, f64::from(steps) / episodes as f64)
}

#[test]
fn a_team_that_knows_the_map_finds_everything() {
    for set in SET_NAMES {
        let (solved, steps) = scripted(set, 40);
        assert!(solved >= 30 && (20.0..400.0).contains(&steps), "{set}: {solved} in {steps}");
    }
}

#[test]
fn steps_alone_play_as_observed_ones_do() {
    let play = |alone: bool| {
        let mut world = opened("task3-2", &[("episode_limit", Setting::Whole(50))]);
        let mut random: Random = generator(1);
        world.reset(0, &mut random);
        let rounds = 50 * 200;
        let returned = if alone {
            step_alone(&mut *world, &mut random, rounds).unwrap()
        } else {
            sortie_envs::observe_and_step(&mut *world, &mut random, rounds)
        };
        returned / 200.0
    };
    assert!((play(true) + 10.0).abs() < 0.5 && (play(false) + 10.0).abs() < 0.5);
}

#[test]
fn what_somebody_looks_at_is_as_it_is_now() {
    // Two worlds of the same draws, one of which is saved and loaded before every step, see the same.
    let mut world = opened("task1-3", &[]);
    let mut other = opened("task1-3", &[]);
    let (mut random, mut same) = (generator(5), generator(5));
    world.reset(0, &mut random);
    let (mut seen, mut again) = (Observation::default(), Observation::default());
    for step in 0..400_u16 {
        let state = saved(&*world);
        other.load(0, &state).unwrap();
        let actions = [step % 5, step / 5 % 4, step / 25 % 4];
        world.step(0, &actions, &mut random).unwrap();
        other.step(0, &actions, &mut same).unwrap();
        world.observe(&saved(&*world), 0, EntitySet::MAX, &mut seen);
        other.observe(&saved(&*other), 0, EntitySet::MAX, &mut again);
        assert_eq!(seen, again);
    }
}
