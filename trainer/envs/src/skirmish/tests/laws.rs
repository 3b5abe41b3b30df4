//! The laws of all environments, sets and settings, and states as bytes.

use std::collections::BTreeMap;

use super::super::observation::BODY;
use super::super::relations::RELATIONS;
use super::super::scenarios::{SETS, Scenario};
use super::super::units::Book;
use crate::frame::{Frame, FrameError};
use crate::random::generator;
use crate::registry::Setting;
use crate::rows::SparseRows;
use crate::{
    EntitySet, Environment, EnvironmentError, Episode, Observation, Split, StateError, StepError,
    UNASSIGNED, conformance, members, open,
};

pub(super) fn opened(set: &str, settings: &[(&str, Setting)]) -> Box<dyn Environment> {
    try_open(set, settings).unwrap_or_else(|error| panic!("{set}: {error}"))
}

fn try_open(
    set: &str,
    settings: &[(&str, Setting)],
) -> Result<Box<dyn Environment>, EnvironmentError> {
    let settings: BTreeMap<_, _> =
        settings.iter().map(|(name, value)| (name.to_string(), value.clone())).collect();
    open(&format!("skirmish/{set}"), Split::Train, 1, &settings)
}

pub(super) fn text(value: &str) -> Setting {
    Setting::Text(value.into())
}

/// The state of the instance.
pub(super) fn saved(environment: &dyn Environment) -> Vec<u8> {
    let mut state = Vec::new();
    environment.save(0, &mut state);
    state
}

#[test]
fn all_sets_hold_to_the_laws() {
    for set in SETS.split(' ').chain(["1m", "5m_vs_6m", "1c3s5z", "16s16z", "12-16sz-symmetric"]) {
        for aim in ["entities", "distance", "tags"] {
            let checked = conformance::check(&*opened(set, &[("aim", text(aim))]), 3, 1);
            assert_eq!(checked, Ok(()), "{set} {aim}");
        }
    }
    let odd = [
        ("rules", text("smaclite")),
        ("intents", Setting::Flag(false)),
        ("spread", Setting::Flag(true)),
        ("extra_seed", Setting::Whole(7)),
    ];
    assert_eq!(conformance::check(&*opened("6-8MMM-disadvantage", &odd), 5, 3), Ok(()));
}

#[test]
fn what_cannot_be_set_up_is_refused_in_a_line() {
    for set in ["", "3-8xy", "0m", "m", "9-3sz", "40m", "3d", "2s3z_vs_", "3-8sz-hard", "25m8d"] {
        let error = try_open(set, &[]).map(|_| ()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("no set `{set}`")) && !error.contains('\n'), "{error}");
    }
    for setting in [("own_losses", Setting::Number(-1.0)), ("aim", text("nobody"))] {
        assert!(matches!(try_open("2s3z", &[setting]), Err(EnvironmentError::Setting(_))));
    }
}

/// Tasks, agents and enemies at most, actions, and what rewards are divided by.
#[test]
fn sets_are_those_of_the_dissertation() {
    let sets = [
        ("3-8sz", (39, [8, 8], 13), 77.5),
        ("3-8csz", (66, [8, 8], 13), 96.5),
        ("3-8MMM", (66, [8, 8], 21), 46.5),
        ("3-8m", (6, [8, 8], 13), 32.0),
        ("6-8sz-symmetric", (39, [8, 8], 13), 77.5),
        ("6-8MMM-symmetric", (66, [8, 8], 21), 46.5),
        ("2s3z", (1, [5, 5], 10), (50.0 + 200.0 + 770.0) / 20.0),
    ];
    for (set, (tasks, most, actions), scale) in sets {
        let scenario = Scenario::named(set, 1).unwrap();
        assert_eq!((scenario.teams.len(), scenario.most()), (tasks, most), "{set}");
        assert_eq!(scenario.reward_scale(&Book::liberty()), scale, "{set}");
        assert_eq!(opened(set, &[]).spec().shape.actions, actions, "{set}");
    }
    for (set, scales) in
        [("6-8sz-disadvantage", [86.0, 85.5]), ("6-8MMM-disadvantage", [49.25, 53.25])]
    {
        let drawn: Vec<f64> = (0..20)
            .map(|seed| Scenario::named(set, seed).unwrap().reward_scale(&Book::liberty()))
            .collect();
        assert!(drawn.iter().all(|scale| scales.contains(scale)), "{set}: {drawn:?}");
        assert!(scales.iter().all(|scale| drawn.contains(scale)), "{set}: {drawn:?}");
        for [allies, enemies] in Scenario::named(set, 1).unwrap().teams {
            assert_eq!(enemies.len(), allies.len() + 1, "{set}");
        }
    }
    assert_eq!(Scenario::named("3-8m", 1).unwrap().limit, 100);
}

/// Plays an episode by the script under a rule.
fn played(set: &str, seed: u64, rule: usize) -> Episode {
    let mut skirmish = opened(set, &[]);
    let agents = skirmish.spec().shape.agents;
    let mut random = generator(seed);
    skirmish.reset(0, &mut random);
    let (mut allocation, mut actions) = (vec![u8::MAX; agents], vec![0; agents]);
    while !skirmish.episode(0).done {
        let state = saved(&*skirmish);
        skirmish.allocate(rule, &state, &mut random, &mut allocation);
        assert!(skirmish.scripted(&state, &allocation, &mut random, &mut actions));
        skirmish.step(0, &actions, &mut random).unwrap();
    }
    skirmish.episode(0)
}

fn share(episodes: &[Episode], holds: impl Fn(&Episode) -> bool) -> f64 {
    episodes.iter().filter(|episode| holds(episode)).count() as f64 / episodes.len() as f64
}

/// How often: measured over 1,500 battles each, with room for chance.
#[test]
fn the_script_wins_as_many_battles_as_it_should() {
    for (set, won) in [("3-8sz", 0.34), ("3-8csz", 0.26), ("3-8MMM", 0.13), ("2s3z", 0.46)] {
        let episodes: Vec<_> = (0..300).map(|seed| played(set, seed, 0)).collect();
        let found = share(&episodes, |episode| episode.solved);
        assert!((found - won).abs() < 0.1, "{set}: {found}");
    }
}

/// And an army that nobody meets reaches the base.
#[test]
fn rules_defend_a_base_better_than_chance() {
    let won = |set: &str, rule| {
        let episodes: Vec<_> = (0..200).map(|seed| played(set, seed, rule)).collect();
        let lost = share(&episodes, |episode| episode.cause == Some("infiltrated"));
        (share(&episodes, |episode| episode.solved), lost)
    };
    let [dynamic, matching, random] = [0, 1, 2].map(|rule| won("6-8sz-symmetric", rule));
    assert!(dynamic.0 > 0.25 && matching.0 > 0.2, "{dynamic:?} {matching:?}");
    assert!(random.0 < 0.05 && random.1 > 0.6, "{random:?}");
    assert!(won("6-8sz-disadvantage", 0).0 < dynamic.0 - 0.1);
}

#[test]
fn bytes_that_are_no_state_are_refused() {
    for set in ["3-8sz", "6-8MMM-disadvantage"] {
        let mut skirmish = opened(set, &[]);
        let mut random = generator(1);
        skirmish.reset(0, &mut random);
        let state = saved(&*skirmish);
        let mut other = opened("2s3z", &[]);
        assert!(matches!(other.load(0, &state), Err(StateError::Impossible(_))));
        assert!(matches!(skirmish.load(0, &[]), Err(StateError::Length { .. })));
        let newer = [&[9], &state[1..]].concat();
        assert_eq!(skirmish.load(0, &newer), Err(StateError::Version { found: 9, wanted: 1 }));
        for length in 1..state.len() {
            assert!(skirmish.load(0, &state[..length]).is_err(), "{length}");
        }
        assert!(skirmish.load(0, &[&state[..], &[0]].concat()).is_err());
        // Whatever is changed is refused, or is a state that an episode goes on from.
        let mut seen = Observation::default();
        for (place, value) in
            (0..state.len()).flat_map(|place| [0, 1, 7, 128, 200, 255].map(|v| (place, v)))
        {
            let mut changed = state.clone();
            changed[place] = value;
            if skirmish.load(0, &changed).is_ok() && !skirmish.episode(0).done {
                skirmish.observe(&changed, 3, EntitySet::MAX, &mut seen);
                let actions: Vec<u16> =
                    seen.available.iter().map(|open| open.trailing_zeros() as u16).collect();
                skirmish.step(0, &actions, &mut random).unwrap();
            }
        }
    }
}

#[test]
fn actions_that_are_not_available_are_refused_and_change_nothing() {
    let mut skirmish = opened("2s3z", &[]);
    skirmish.reset(0, &mut generator(1));
    let state = saved(&*skirmish);
    let mut random = generator(2);
    // Nobody is near yet.
    let refused = skirmish.step(0, &[0, 0, 6, 0, 0], &mut random);
    assert_eq!(refused, Err(StepError::Unavailable { agent: 2, action: 6 }));
    let refused = skirmish.step(0, &[0; 4], &mut random);
    assert_eq!(refused, Err(StepError::TooFewActions { agents: 5, actions: 4 }));
    assert_eq!(saved(&*skirmish), state);
}

/// The way that an agent went shows as that of the action which it has under a symmetry, and all symmetries differ.
#[test]
fn ways_and_actions_turn_alike() {
    for action in 1..5_u16 {
        let mut skirmish = opened("1m", &[]);
        skirmish.reset(0, &mut generator(1));
        skirmish.step(0, &[action], &mut generator(2)).unwrap();
        let state = saved(&*skirmish);
        let mut seen = Observation::default();
        let names = skirmish.spec().features.clone();
        let column = |name: &str| names.iter().position(|known| known == name).unwrap();
        let columns = ["moved-x", "moved-y", "x", "y"].map(column);
        let mut shown = Vec::new();
        for turn in 0..skirmish.spec().turns {
            skirmish.observe(&state, turn, 1, &mut seen);
            let mut row = vec![0.0; names.len()];
            seen.rows.write_dense(0, &mut row);
            let [east, north, x, y] = columns.map(|column| row[column]);
            let way = match skirmish.turned_action(turn, action) {
                1 => [0.0, 1.0],
                2 => [1.0, 0.0],
                3 => [0.0, -1.0],
                _ => [-1.0, 0.0],
            };
            assert!(east * way[0] + north * way[1] > 0.4, "{action} {turn}: {east} {north}");
            assert!(!shown.contains(&[x, y]), "{turn} shows what another one does");
            shown.push([x, y]);
        }
    }
}

/// What allies lose counts while learning, where that is set, and never when it is measured.
#[test]
fn own_losses_lower_what_is_learned_from_alone() {
    let returned = |own_losses: f64, split| {
        let settings = [("own_losses".to_string(), Setting::Number(own_losses))];
        let mut skirmish = open("skirmish/2s3z", split, 1, &settings.into()).unwrap();
        let mut random = generator(5);
        skirmish.reset(0, &mut random);
        while !skirmish.episode(0).done {
            skirmish.step(0, &[0; 5], &mut random).unwrap();
        }
        skirmish.episode(0).episode_return
    };
    assert_eq!(returned(0.0, Split::Train), 0.0);
    assert_eq!(returned(1.0, Split::Test), 0.0);
    // All are lost: their bodies, and ten for each.
    let lost = (2.0 * 160.0 + 3.0 * 150.0 + 50.0) / ((50.0 + 200.0 + 770.0) / 20.0);
    assert!((returned(1.0, Split::Train) + lost).abs() < 1.0, "{}", returned(1.0, Split::Train));
}

/// Around a base the armies that allies are lost to are told apart, and all that is lost is lost to one of them.
#[test]
fn own_losses_are_those_of_armies() {
    let settings = [("own_losses".to_string(), Setting::Number(1.0))];
    let name = "skirmish/4s-disadvantage";
    let mut skirmish = open(name, Split::Train, 1, &settings.into()).unwrap();
    let (mut random, mut worst) = (generator(3), [0.0_f64; 3]);
    for _ in 0..20 {
        skirmish.reset(0, &mut random);
        while !skirmish.episode(0).done {
            let step = skirmish.step(0, &[0; 4], &mut random).unwrap();
            let rewards = skirmish.task_rewards(0);
            assert!((rewards.iter().sum::<f64>() - step.reward).abs() < 1e-9);
            worst.iter_mut().zip(rewards).for_each(|(worst, it)| *worst = worst.min(*it));
        }
    }
    assert!(worst.iter().all(|worst| *worst < 0.0), "{worst:?}");
}

/// What a process would read of a state.
fn rows_of(environment: &dyn Environment, state: &[u8]) -> (Vec<f32>, Observation) {
    let mut seen = Observation::default();
    environment.observe(state, 0, EntitySet::MAX, &mut seen);
    let features = environment.spec().shape.features;
    let mut rows = vec![0.0; features * environment.spec().shape.entities];
    for (row, entity) in members(seen.entities).enumerate() {
        seen.rows.write_dense(row, &mut rows[entity * features..][..features]);
    }
    (rows, seen)
}

/// While all live: agents of one type are interchangeable, so that who is first does not matter.
#[test]
fn rules_find_the_same_in_frames() {
    let mut skirmish = opened("4s-disadvantage", &[]);
    let mut random = generator(8);
    let mut reader = super::super::frames::reader();
    for _ in 0..20 {
        skirmish.reset(0, &mut random);
        let state = saved(&*skirmish);
        let (rows, seen) = rows_of(&*skirmish, &state);
        let (stride, open_tasks) = (skirmish.spec().shape.features, seen.open_tasks as u32);
        let present = seen.present & !EntitySet::from(seen.absent);
        let frame =
            Frame { rows: &rows, stride, agents: 4, tasks: 3, present, open_tasks, available: &[] };
        reader.read(&frame).unwrap();
        for rule in 0..2 {
            let [mut own, mut read] = [[9; 4], [9; 4]];
            skirmish.allocate(rule, &state, &mut random, &mut own);
            reader.allocate(rule, &mut random, &mut read).unwrap();
            own.sort_unstable();
            read.sort_unstable();
            assert_eq!(read, own, "rule {rule}");
        }
        // Who dies leaves the others their armies.
        let mut before = [9; 4];
        reader.allocate(1, &mut random, &mut before).unwrap();
        reader.read(&Frame { present: present & !0b10, ..frame }).unwrap();
        let mut behind = [9; 4];
        reader.allocate(1, &mut random, &mut behind).unwrap();
        before[1] = UNASSIGNED;
        assert_eq!(behind, before);
        reader.read(&frame).unwrap();
        let mut drawn = [9; 6];
        reader.allocate(2, &mut random, &mut drawn).unwrap();
        assert!(drawn[..4].iter().all(|army| open_tasks >> army & 1 == 1));
        assert_eq!(drawn[4..], [UNASSIGNED; 2]);
        assert_eq!(reader.allocate(0, &mut random, &mut [0; 3]), Err(FrameError::BadLength));
    }
}

/// What a network is told of an army is the same to the bit where it learns and where it is deployed, and is what the
/// encounter comes to: sums over the living.
#[test]
fn relations_are_read_back_from_frames() {
    let mut skirmish = opened("4s-disadvantage", &[]);
    let (mut random, mut reader) = (generator(9), super::super::frames::reader());
    let mut dead = 0;
    for _ in 0..10 {
        skirmish.reset(0, &mut random);
        while !skirmish.episode(0).done {
            let state = saved(&*skirmish);
            let (rows, seen) = rows_of(&*skirmish, &state);
            let (stride, open_tasks) = (skirmish.spec().shape.features, seen.open_tasks as u32);
            let present = seen.present & !EntitySet::from(seen.absent);
            let (agents, tasks) = (4, 3);
            reader
                .read(&Frame {
                    rows: &rows,
                    stride,
                    agents,
                    tasks,
                    present,
                    open_tasks,
                    available: &[],
                })
                .unwrap();
            dead += seen.absent.count_ones();
            for task in (0..3).filter(|task| open_tasks >> task & 1 == 1) {
                let mut own = SparseRows::default();
                skirmish.relate(&state, 0, task, EntitySet::MAX, &mut own);
                let entities = skirmish.spec().shape.entities;
                let mut read = vec![9.0; entities * RELATIONS];
                reader.relate(task, &mut read);
                let mut written = vec![0.0; entities * RELATIONS];
                for (row, entity) in members(seen.present).enumerate() {
                    own.write_dense(row, &mut written[entity * RELATIONS..][..RELATIONS]);
                }
                assert_eq!(read, written);
                let army = members(seen.things_of(task)).map(|thing| {
                    let row = &rows[thing * stride..];
                    row[BODY[0]] + row[BODY[1]]
                });
                let strength = army.sum::<f32>() / 8.0;
                let agent = members(present).next().unwrap();
                assert!((read[agent * RELATIONS + 3] - strength).abs() < 1e-5);
            }
            let mut actions = [0; 4];
            let allocation: Vec<u8> = vec![0; 4];
            skirmish.scripted(&state, &allocation, &mut random, &mut actions);
            skirmish.step(0, &actions, &mut random).unwrap();
        }
    }
    assert!(dead > 0);
}

#[test]
fn frames_that_show_no_encounter_are_refused() {
    let mut skirmish = opened("4s-disadvantage", &[]);
    skirmish.reset(0, &mut generator(8));
    let (rows, seen) = rows_of(&*skirmish, &saved(&*skirmish));
    let stride = skirmish.spec().shape.features;
    let present = seen.present;
    let read = |rows: &[f32], tasks: usize| {
        let frame =
            Frame { rows, stride, agents: 4, tasks, present, open_tasks: 1, available: &[] };
        super::super::frames::reader().read(&frame)
    };
    let changed = |column: usize, value: f32| {
        let mut rows = rows.clone();
        rows[2 * stride + column] = value;
        read(&rows, 3)
    };
    assert_eq!(read(&rows, 3), Ok(()));
    assert_eq!(read(&rows, 4), Err(FrameError::TooLarge));
    assert_eq!(read(&rows[..stride], 3), Err(FrameError::BadLength));
    assert_eq!(changed(8, f32::NAN), Err(FrameError::NonFinite { entity: 2 }));
    // A stalker no more.
    assert_eq!(changed(5, 0.5), Err(FrameError::BadRow { entity: 2 }));
}
