//! The laws of all environments, what is seen, states as bytes, and what can be set.

use std::collections::BTreeMap;

use super::super::battle::{Battle, STOP};
use super::super::scenarios::SETS;
use super::super::units::Rules;
use super::{opened, saved, smax};
use crate::random::generator;
use crate::registry::Setting;
use crate::{
    EntitySet, Environment, Observation, Split, StateError, StepError, View, conformance, open,
};

const YES: Setting = Setting::Flag(true);
const NO: Setting = Setting::Flag(false);

fn text(value: &str) -> Setting {
    Setting::Text(value.into())
}

#[test]
fn all_sets_hold_to_the_laws() {
    for set in SETS.split(' ').chain(["1m_vs_1m", "5m_vs_59m"]) {
        assert_eq!(conformance::check(&*opened(set, &[]), 3, 2), Ok(()), "{set}");
        assert_eq!(conformance::check(&*opened(set, &[("pairs", NO)]), 3, 1), Ok(()), "{set}");
    }
    for set in ["2s3z", "1m_vs_1m", "smacv2_5_units", "32m"] {
        for rules in ["0.2.0", "classic"] {
            let settings = [("vectors", YES), ("rules", text(rules))];
            assert_eq!(conformance::check(&*opened(set, &settings), 4, 2), Ok(()), "{set}");
        }
    }
    let odd = [
        ("rules", text("classic")),
        ("attack_mode", text("random")),
        ("see_enemy_actions", NO),
        ("self_play_reward", YES),
        ("walls_cause_death", NO),
        ("max_steps", Setting::Whole(30)),
    ];
    assert_eq!(conformance::check(&*opened("3-8sz+1", &odd), 5, 3), Ok(()));
}

#[test]
fn shapes_are_those_of_the_rule_book() {
    let shape = |set: &str| opened(set, &[("pairs", NO)]).spec().shape;
    assert_eq!((shape("2s3z").features, shape("2s3z").actions), (24, 10));
    let tasks = shape("3-8sz");
    assert_eq!((tasks.agents, tasks.entities, tasks.features, tasks.actions), (8, 16, 30, 13));
    let harder = shape("3-8sz+1");
    assert_eq!((harder.entities, harder.features, harder.actions), (17, 31, 14));
    let spec = opened("27m_vs_30m", &[]).spec().clone();
    assert_eq!(
        (spec.targets.clone(), spec.target_of(5), spec.episode_limit),
        (27..57, Some(27), 101)
    );
    let vectors = opened("2s3z", &[("vectors", YES)]);
    let spec = vectors.spec();
    assert_eq!((spec.view, spec.shape.features, spec.shape.entities), (View::Vectors, 127, 6));
    assert_eq!(spec.features[12..14], ["other-1-hydralisk", "other-2-health"]);
    assert_eq!(spec.features[117..122], ["health", "x", "y", "cooldown", "marine"]);
}

/// A row by the names of its columns that are no zeros.
fn row(world: &dyn Environment, seen: &Observation, entity: usize) -> BTreeMap<String, f32> {
    let entries = seen.rows.row(seen.row_of(entity));
    entries.map(|(column, value)| (world.spec().features[column].clone(), value)).collect()
}

fn named<const COUNT: usize>(values: [(&str, f32); COUNT]) -> BTreeMap<String, f32> {
    values.into_iter().map(|(name, value)| (name.into(), value)).collect()
}

/// One stalker and two zealots against as many and one more, in a set of teams up to eight.
fn skirmish() -> Battle {
    let mut battle = Battle::of(&[2, 3, 3], &[2, 2, 3, 3]);
    for (unit, x) in battle.units.iter_mut().zip([8.0, 9.0, 30.0, 16.0, 20.0, 12.0, 10.0]) {
        unit.place = [x, 16.0];
    }
    (battle.units[0].order, battle.units[0].health, battle.units[0].cooldown) = (6, 40, 0.935);
    (battle.units[5].order, battle.units[5].cooldown) = (7, -1.0);
    battle.units[3].order = 3;
    battle.units[6].health = 0;
    battle
}

#[test]
fn rows_say_what_the_rule_book_says() {
    let mut world = smax("3-8sz+1", Rules::default());
    let battle = skirmish();
    world.battles[0] = battle.clone();
    let mut seen = Observation::new(&world.spec().shape);
    world.observe(&saved(&world), 0, EntitySet::MAX, &mut seen);
    assert_eq!(seen.present, 0b1111_0000_0111);
    assert_eq!((seen.absent, seen.acting()), (0, 0b111));
    // The stalker sees the ally, an enemy eight away and one four away; nobody sees the dead.
    assert_eq!(seen.observable[..4], [0b101_0000_0011, 0b101_0000_0011, 0b100, 0]);
    assert_eq!(seen.available[..4], [0b1001_1111, 0b1_1111, 0b1_1111, 1]);
    let stalker = [
        ("ally-0", 1.0),
        ("stalker", 1.0),
        ("health", 0.25),
        ("x", 0.25),
        ("y", 0.5),
        ("attacked", 6.0 / 13.0),
        ("cooldown", 0.5),
        ("enemy-0-east", 0.8),
        ("enemy-2-east", 0.4),
    ];
    assert_eq!(row(&world, &seen, 0), named(stalker));
    let walker = [
        ("enemy-0", 1.0),
        ("is-enemy", 1.0),
        ("stalker", 1.0),
        ("health", 1.0),
        ("x", 0.5),
        ("y", 0.5),
        ("moved-x", -1.0),
    ];
    assert_eq!(row(&world, &seen, 8), named(walker));
    let shooter = [
        ("enemy-2", 1.0),
        ("is-enemy", 1.0),
        ("zealot", 1.0),
        ("health", 1.0),
        ("x", 0.375),
        ("y", 0.5),
        ("attacked", 7.0 / 13.0),
    ];
    assert_eq!(row(&world, &seen, 10), named(shooter));
    let dead = [("enemy-3", 1.0), ("is-enemy", 1.0), ("zealot", 1.0)];
    assert_eq!(row(&world, &seen, 11), named(dead));

    world.rules.see_enemy_actions = false;
    world.battles[0].units[1].health = 0;
    world.observe(&saved(&world), 0, EntitySet::MAX, &mut seen);
    assert!(!row(&world, &seen, 8).contains_key("moved-x"));
    assert!(!row(&world, &seen, 10).contains_key("attacked"));
    assert!(row(&world, &seen, 0).contains_key("attacked"));
    assert_eq!((seen.absent, seen.observable[1], seen.available[1]), (0b10, 0b10, 1 << STOP));

    // In a set of one size attacks are shares of the team's own last action.
    let mut fixed = smax("1s2z_vs_2s2z", Rules::default());
    fixed.battles[0] = battle;
    fixed.observe(&saved(&fixed), 0, EntitySet::MAX, &mut seen);
    assert_eq!(row(&fixed, &seen, 0)["attacked"], 6.0 / 8.0);
    assert_eq!(row(&fixed, &seen, 5)["attacked"], 7.0 / 7.0);
}

#[test]
fn vectors_have_the_whole_state_behind_the_agents() {
    let mut world = smax("1s2z_vs_2s2z", Rules { vectors: true, ..Rules::default() });
    world.battles[0] = skirmish();
    let mut seen = Observation::new(&world.spec().shape);
    world.observe(&saved(&world), 0, EntitySet::MAX, &mut seen);
    assert_eq!((seen.present, seen.observable.clone()), (0b1111, vec![0b1, 0b10, 0b100]));
    let (mut vector, mut state) = (vec![0.0; 88], vec![0.0; 88]);
    world.battles[0].write_vector(&world.rules, 1, &mut vector);
    world.battles[0].write_state(&mut state);
    let (mut first, mut last) = (vec![0.0; 88], vec![0.0; 88]);
    seen.rows.write_dense(1, &mut first);
    seen.rows.write_dense(3, &mut last);
    assert_eq!((first, last), (vector, state));
}

#[test]
fn actions_that_are_not_available_are_refused() {
    let mut world = smax("1s2z_vs_2s2z", Rules::default());
    world.battles[0] = skirmish();
    world.battles[0].units[1].health = 0;
    let before = saved(&world);
    let unavailable = |agent, action| Err(StepError::Unavailable { agent, action });
    let mut refused = |actions: &[u16]| {
        let refused = world.step(0, actions, &mut generator(1));
        assert_eq!(saved(&world), before);
        refused
    };
    assert_eq!(refused(&[5, 4, 4]), unavailable(0, 5));
    assert_eq!(refused(&[7, 0, 4]), unavailable(1, 0));
    assert_eq!(refused(&[7, 4, 9]), unavailable(2, 9));
    assert_eq!(refused(&[7, 4, 64]), unavailable(2, 64));
    assert_eq!(refused(&[7, 4]), Err(StepError::TooFewActions { agents: 3, actions: 2 }));
    assert!(world.step(0, &[7, 4, 4], &mut generator(1)).is_ok());
}

#[test]
fn bytes_that_hold_no_state_are_refused_and_change_nothing() {
    let mut world = smax("1s2z_vs_2s2z", Rules::default());
    world.battles[0] = skirmish();
    let good = saved(&world);
    assert_eq!(good.len(), world.spec().state_bytes);
    let unit = 15;
    let with = |at: usize, bytes: &[u8]| {
        let mut state = good.clone();
        state[at..at + bytes.len()].copy_from_slice(bytes);
        state
    };
    let length = |found, wanted| StateError::Length { found, wanted };
    let impossible = |flaw: &str| StateError::Impossible(flaw.into());
    let none = "one of its numbers is none";
    let crowd = [&[1, 255, 1], &*vec![0; 15 - 3 + 256 * 24]].concat();
    for (state, want) in [
        (Vec::new(), length(0, 15 + 2 * 24)),
        (good[..9].to_vec(), length(9, good.len())),
        ([&*good, &[0]].concat(), length(good.len() + 1, good.len())),
        (with(0, &[2]), StateError::Version { found: 2, wanted: 1 }),
        (with(1, &[4, 3]), impossible("4 allies meet 3 enemies")),
        (crowd, impossible("255 allies meet 1 enemies")),
        (with(3, &102_u32.to_le_bytes()), impossible("`1s2z_vs_2s2z` after 102 steps")),
        (with(7, &f64::NAN.to_le_bytes()), impossible("its return is no number")),
        (with(unit, &[6]), impossible("a unit is of type 6")),
        (with(unit, &[3, 0, 150]), impossible("`3z_vs_2s2z` after 0 steps")),
        (with(unit + 1, &[9]), impossible("a unit took action 9")),
        (with(unit + 3 * 24 + 1, &[8]), impossible("a unit took action 8")),
        (with(unit + 2, &[161]), impossible("a unit of type 2 has a health of 161")),
        (with(unit + 3, &[3]), impossible("an enemy shoots at ally 3")),
        (with(unit + 4, &f32::NAN.to_le_bytes()), impossible(none)),
        (with(unit + 12, &f32::INFINITY.to_le_bytes()), impossible(none)),
        (with(unit + 20, &f32::NAN.to_le_bytes()), impossible(none)),
    ] {
        assert_eq!(world.load(0, &state), Err(want));
        assert_eq!(saved(&world), good);
    }
    let mut other = smax("1s2z_vs_2s2z", Rules::default());
    other.load(0, &good).unwrap();
    assert_eq!(saved(&other), good);
    assert_eq!(other.battles[0].units, skirmish().units);
    let drawn = smax("smacv2_5_units", Rules::default());
    let has = |allies: &[u8], enemies: &[u8]| drawn.roster.has(&[allies.into(), enemies.into()]);
    assert!(has(&[1, 2, 3, 4, 5], &[1, 2, 3, 4, 5]));
    assert!(!has(&[1, 2, 3, 4, 5], &[1, 2, 3, 4, 4]));
    assert!(!has(&[1; 4], &[1; 4]));
}

#[test]
fn settings_change_the_rules_and_wrong_ones_are_named() {
    assert_eq!(opened("2s3z", &[("max_steps", Setting::Whole(7))]).spec().episode_limit, 8);
    let refused = |set: &str, name: &str, value| {
        let settings = BTreeMap::from([(name.to_owned(), value)]);
        open(&format!("smax/{set}"), Split::Train, 1, &settings).err().unwrap().to_string()
    };
    let wrong = refused("2s3z", "rules", text("old"));
    assert_eq!(wrong, "unknown variant `old`, expected `0.2.0` or `classic`");
    let wrong = refused("2s3z", "attack_mode", text("none"));
    assert_eq!(wrong, "unknown variant `none`, expected `closest` or `random`");
    assert!(refused("2s3z", "attack_mode", YES).contains("bool"));
    assert!(refused("2s3z", "shields", YES).contains("`shields`"));
    let many = refused("2s3z", "max_steps", Setting::Whole(1_000_001));
    assert_eq!(many, "`max_steps` is at most 1000000");
    assert!(refused("3-8sz", "vectors", YES).starts_with("`vectors` have one length"));
    assert!(refused("2x", "vectors", YES).starts_with("no set `2x`; there are `3-8sz`"));
}
