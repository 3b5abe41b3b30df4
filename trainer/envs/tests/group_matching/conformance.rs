//! Group Matching by its name, and the laws of all environments.

use std::collections::BTreeMap;

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
        ("noise", Setting::Number(1.5), "the noise is not a probability from 0 to 1"),
        ("episode_limit", Setting::Flag(true), "invalid type: boolean `true`"),
    ] {
        let error = opened(name, value).err().unwrap().to_string();
        assert!(error.starts_with(words), "{error}");
    }
    let error = open("group-matching/8x6", Split::Train, 1, &BTreeMap::new()).err().unwrap();
    assert!(error.to_string().starts_with("no set `8x6`"), "{error}");
}
