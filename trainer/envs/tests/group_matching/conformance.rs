//! Group Matching by its name, and the laws of all environments.

use std::collections::BTreeMap;

use sortie_envs::random::generator;
use sortie_envs::registry::Setting;
use sortie_envs::{Split, conformance, open};

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
        ("held_out", Setting::Whole(8), "a held-out size of groups needs two drawn groups"),
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
        let mut groups = std::collections::BTreeSet::new();
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
