//! The games as environments: the common laws, settings, and what is refused.

use sortie_envs::random::generator;
use sortie_envs::registry::Setting;
use sortie_envs::{Split, StateError, conformance};

use super::open;

#[test]
fn every_task_holds_to_the_laws_of_environments() {
    for (name, settings) in [
        ("crafting", vec![("training_limit", Setting::Whole(300))]),
        ("crafting/iron", vec![("loss", Setting::Number(0.3))]),
        ("crafting/diamond", vec![("dense", Setting::Flag(true)), ("limit", Setting::Whole(40))]),
        ("treasure-rooms", vec![("training_limit", Setting::Whole(700))]),
    ] {
        let world = open(name, Split::Train, &settings).unwrap();
        assert_eq!(conformance::check(&*world, 3, 4), Ok(()), "{name}");
    }
}

#[test]
fn episodes_to_learn_from_are_shorter_than_those_that_are_measured() {
    for (split, want) in [(Split::Train, 7), (Split::Test, 4_320)] {
        let settings = [("training_limit", Setting::Whole(7))];
        let mut world = open("crafting/iron", split, &settings).unwrap();
        let mut random = generator(1);
        world.reset(0, &mut random);
        let mut steps = 1;
        while !world.step(0, &[0], &mut random).unwrap().done() {
            steps += 1;
        }
        assert_eq!((steps, world.episode(0).cause), (want, Some("time")));
    }
}

#[test]
fn sets_of_milestones_hold_the_task_and_keep_the_order() {
    let all = open("crafting/iron", Split::Train, &[]).unwrap().spec().milestones.clone();
    assert_eq!((all.len(), &*all[0], &*all[10]), (11, "log", "iron"));
    let mut drawn = std::collections::BTreeSet::new();
    for seed in 0..8 {
        let settings =
            [("milestones", Setting::Whole(6)), ("milestones_seed", Setting::Whole(seed))];
        let some = open("crafting/iron", Split::Train, &settings).unwrap();
        let some = some.spec().milestones.clone();
        assert_eq!((some.len(), &*some[5]), (6, "iron"));
        let mut rest = all.iter();
        assert!(some.iter().all(|name| rest.any(|other| other == name)), "{some:?}");
        drawn.insert(some);
    }
    assert!(drawn.len() > 4, "{drawn:?}");
}

#[test]
fn impossible_choices_are_refused_with_what_is_possible() {
    for (name, setting, words) in [
        (
            "crafting/gold",
            ("limit", Setting::Whole(1)),
            "no task `gold`; there are `iron`, `diamond`",
        ),
        ("crafting/iron", ("milestones", Setting::Whole(12)), "12 milestones, there are 1 to 11"),
        ("crafting/iron", ("loss", Setting::Number(1.5)), "`loss` is 1.5, a probability"),
        ("treasure-rooms", ("loss", Setting::Number(0.1)), "`loss` is not for this game"),
        ("treasure-rooms", ("training_limit", Setting::Whole(0)), "`training_limit` is 0"),
        ("treasure-rooms", ("noise", Setting::Whole(0)), "unknown field `noise`"),
    ] {
        let error = open(name, Split::Train, &[setting]).err().unwrap().to_string();
        assert!(error.starts_with(words), "{error}");
    }
}

#[test]
fn bytes_that_hold_no_state_are_refused_and_change_nothing() {
    let mut world = open("crafting/iron", Split::Train, &[]).unwrap();
    world.reset(0, &mut generator(1));
    let mut good = Vec::new();
    world.save(0, &mut good);
    assert_eq!(good.len(), world.spec().state_bytes);
    let with = |at: usize, byte: u8| {
        let mut state = good.clone();
        state[at] = byte;
        state
    };
    let length = |found| StateError::Length { found, wanted: good.len() };
    let impossible = |flaw: &str| StateError::Impossible(flaw.into());
    for (state, want) in [
        (Vec::new(), length(0)),
        (good[..40].to_vec(), length(40)),
        (with(0, 2), StateError::Version { found: 2, wanted: 1 }),
        (with(2, 9), impossible("it is 2304 of 1500 steps long")),
        (with(18, 12), impossible("the agent is in cell 12")),
        (with(19, 4), impossible("the agent looks in direction 4")),
        (with(20, 11), impossible("it carries object 11")),
        (with(good.len() - 1, 11), impossible("a cell holds object 11")),
    ] {
        assert_eq!(world.load(0, &state), Err(want));
        let mut after = Vec::new();
        world.save(0, &mut after);
        assert_eq!(after, good);
    }
}
