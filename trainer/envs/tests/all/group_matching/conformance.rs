//! Group Matching by its name, and the laws of all environments.

use std::collections::{BTreeMap, BTreeSet};

use sortie_envs::random::generator;
use sortie_envs::registry::Setting;
use sortie_envs::{EntitySet, Split, conformance, open};

#[test]
fn rings_of_all_kinds_hold_to_the_laws() {
    for set in ["", "/8x6x2-fixed", "/1x1x1", "/5x3x4", "/64x256x20"] {
        let name = format!("group-matching{set}");
        let ring = open(&name, Split::Train, 2, &BTreeMap::new()).unwrap();
        assert_eq!(conformance::check(&*ring, 3, 6), Ok(()), "{name}");
    }
}

#[test]
fn settings_change_the_rules_and_unknown_ones_are_named() {
    let opened = |name: &str, value| {
        let settings = BTreeMap::from([(name.to_string(), value)]);
        open("group-matching", Split::Train, 1, &settings)
    };
    let short = opened("episode_limit", Setting::Whole(7)).unwrap();
    assert_eq!(short.spec().episode_limit, 7);
    for (name, value, words) in [
        ("noice", Setting::Number(0.5), "unknown field `noice`"),
        ("held_out", Setting::Whole(9), "what is held out leaves no starts to learn from"),
        ("held_out_members", Setting::Whole(5), "what is held out leaves no starts to learn from"),
        ("held_out_share", Setting::Number(1.5), "what is held out leaves no starts to learn from"),
        ("noise", Setting::Number(1.5), "the noise is not a probability from 0 to 1"),
        ("episode_limit", Setting::Flag(true), "invalid type: boolean `true`"),
    ] {
        let error = opened(name, value).err().unwrap().to_string();
        assert!(error.starts_with(words), "{error}");
    }
    let error = open("group-matching/8x6", Split::Train, 1, &BTreeMap::new()).err().unwrap();
    assert!(error.to_string().starts_with("no set `8x6`"), "{error}");
}

#[test]
fn a_size_that_is_held_out_is_met_where_it_is_measured_only() {
    let settings = BTreeMap::from([("held_out".to_string(), Setting::Whole(3))]);
    for (split, measures) in [(Split::Train, false), (Split::Test, true)] {
        let mut ring = open("group-matching/8x6x3", split, 1, &settings).unwrap();
        let mut random = generator(1);
        let mut groups = BTreeSet::new();
        for _ in 0..500 {
            ring.reset(0, &mut random);
            let group = ring.episode(0).group;
            assert_eq!(group.split('+').any(|size| size == "3"), measures, "{group}");
            groups.insert(group);
        }
        assert!(groups.len() > 8, "{groups:?}");
        assert_eq!(conformance::check(&*ring, 3, 6), Ok(()));
    }
}

/// The groups of so many starts of a split.
fn groups(set: &str, split: Split, setting: (&str, Setting), starts: usize) -> Vec<Vec<EntitySet>> {
    let settings = BTreeMap::from([(setting.0.to_string(), setting.1)]);
    let mut ring = open(&format!("group-matching/{set}"), split, 1, &settings).unwrap();
    assert_eq!(conformance::check(&*ring, 3, 6), Ok(()));
    let agents = ring.spec().shape.agents;
    let (mut random, mut state) = (generator(1), Vec::new());
    let mut start = || {
        ring.reset(0, &mut random);
        state.clear();
        ring.save(0, &mut state);
        let mut companions = vec![0; agents];
        ring.companions(&state, &mut companions);
        companions
    };
    (0..starts).map(|_| start()).collect()
}

#[test]
fn two_groups_of_some_size_are_met_where_it_is_measured_only() {
    let setting = || ("held_out_members", Setting::Whole(2));
    // Whoever has a companion.
    let large = |companions: &[EntitySet]| {
        let groups: BTreeSet<_> = companions.iter().filter(|set| set.count_ones() > 1).collect();
        groups.len()
    };
    assert!(groups("8x6x2", Split::Train, setting(), 300).iter().all(|start| large(start) == 1));
    assert!(groups("8x6x2", Split::Test, setting(), 300).iter().all(|start| large(start) == 2));
}

#[test]
fn ways_to_group_that_are_held_out_are_met_where_it_is_measured_only() {
    let starts = |split| -> BTreeSet<_> {
        let setting = ("held_out_share", Setting::Number(0.75));
        groups("6x3x2", split, setting, 2_000).into_iter().collect()
    };
    let (known, others) = (starts(Split::Train), starts(Split::Test));
    assert!(known.is_disjoint(&others));
    // Of 32 ways, counting those that differ in the groups' names once.
    assert!((6..26).contains(&known.len()), "{} and {}", known.len(), others.len());
    assert!(others.len() > known.len(), "{} and {}", known.len(), others.len());
}
