//! The sets by their names, the laws of all environments, and what the environment says of itself.

use std::collections::BTreeMap;

use sortie_envs::particle::SET_NAMES;
use sortie_envs::registry::Setting;
use sortie_envs::{SpecError, Split, View, conformance, open};

use super::opened;

#[test]
fn scenarios_of_all_sizes_hold_to_the_laws() {
    let odd = ["treasure-64", "rover-tower-2", "rover-tower-64", "navigation-1", "navigation-64"];
    for set in SET_NAMES.into_iter().chain(odd) {
        assert_eq!(conformance::check(&*opened(set, &[]), 3, 2), Ok(()), "{set}");
    }
    let far = opened("treasure-8", &[("dead_treasures", Setting::Text("far".into()))]);
    assert_eq!(conformance::check(&*far, 3, 6), Ok(()));
}

#[test]
fn the_default_is_the_published_size() {
    let world = open("particle", Split::Train, 3, &BTreeMap::new()).unwrap();
    let spec = world.spec();
    assert_eq!((spec.shape.agents, spec.shape.entities, spec.shape.features), (8, 8, 86));
    assert_eq!((spec.view, world.instances()), (View::Vectors, 3));
    assert_eq!((spec.rewards.tasks, spec.rewards.agents), (false, true));
}

#[test]
fn roles_say_who_sees_and_does_what() {
    let world = opened("rover-tower-10", &[]);
    let [rover, tower] = &world.spec().roles[..] else { panic!("two roles") };
    assert_eq!((rover.name, rover.agents.clone(), rover.features.len()), ("rover", 0..5, 14));
    assert_eq!((tower.name, tower.agents.clone(), tower.features.len()), ("tower", 5..10, 9));
    assert_eq!(rover.actions, ["none", "right", "left", "up", "down"]);
    assert_eq!(tower.actions, ["say-0", "say-1", "say-2", "say-3", "say-4"]);
    let ends = ["rover-4", "rover-x", "rover-y", "goal-x", "goal-y"];
    assert_eq!(tower.features[4..], ends);
    assert_eq!(tower.units[3..6], ["flag", "flag", "half sides of the square"]);
    assert_eq!(world.spec().features_of(4), rover.features);
    assert_eq!(world.spec().features_of(5), tower.features);
    assert_eq!(world.spec().actions_of(9), tower.actions);
    assert_eq!(world.spec().features, rover.features);

    let hunt = opened("treasure-12", &[]);
    let collector = &hunt.spec().roles[0];
    let (other, treasure) = (4 + 3 + 2 * 10, 4 + 3 + 7 * 10 + 5);
    let names = ["other-2-x", "other-2-y", "other-2-velocity-x", "other-2-velocity-y"];
    assert_eq!(collector.features[other..other + 4], names);
    assert_eq!(collector.features[other + 9], "other-2-holds-2");
    assert_eq!(collector.features[treasure..treasure + 2], ["treasure-1-x", "treasure-1-y"]);

    let alike = opened("navigation-3", &[]);
    assert_eq!(alike.spec().roles, []);
    assert_eq!(alike.spec().features_of(2)[16..], ["other-1-says-0", "other-1-says-1"]);
}

#[test]
fn roles_that_do_not_fit_are_refused() {
    let spec = opened("rover-tower-8", &[]).spec().clone();
    assert_eq!(spec.check(), Ok(()));
    let refused = |change: fn(&mut sortie_envs::Spec)| {
        let mut spec = spec.clone();
        change(&mut spec);
        spec.check().unwrap_err()
    };
    assert_eq!(refused(|spec| spec.roles.swap(0, 1)), SpecError::Roles { agent: 0 });
    assert_eq!(refused(|spec| spec.roles[1].agents = 5..8), SpecError::Roles { agent: 4 });
    assert_eq!(refused(|spec| spec.roles[0].agents = 0..5), SpecError::Roles { agent: 5 });
    let short = refused(|spec| spec.roles[1].agents = 4..7);
    assert_eq!(short.to_string(), "agent 7 has no role, or one out of order");
    let most = refused(|spec| spec.roles[1].actions.push("sing".into()));
    assert_eq!(most.to_string(), "6 actions of a role; from 1 to 5 are possible");
    let none = refused(|spec| spec.roles[1].features.clear());
    assert_eq!(none.to_string(), "0 features of a role; from 1 to 13 are possible");
    let units = refused(|spec| spec.roles[1].units.truncate(7));
    assert_eq!(units.to_string(), "7 names were given for 8 units of a role");
}

#[test]
fn settings_change_the_rules_and_unknown_ones_are_named() {
    for set in ["treasure-4", "rover-tower-8", "navigation-2"] {
        let short = opened(set, &[("episode_limit", Setting::Whole(7))]);
        assert_eq!(short.spec().episode_limit, 7);
    }
    let refused = |set: &str, name: &str, value| {
        let settings = BTreeMap::from([(name.to_owned(), value)]);
        open(&format!("particle/{set}"), Split::Train, 1, &settings).err().unwrap().to_string()
    };
    let zeros = || Setting::Text("zeros".into());
    assert!(refused("navigation-3", "dead_treasures", zeros()).contains("`dead_treasures`"));
    let near = refused("treasure-8", "dead_treasures", Setting::Text("near".into()));
    assert_eq!(near, "`dead_treasures` is `far` or `zeros`");
    let none = refused("treasure-8", "episode_limit", Setting::Whole(0));
    assert_eq!(none, "an episode limit of 0 steps leaves no episode");
    for set in ["treasure", "treasure-6", "treasure-0", "rover-tower-9", "navigation-65", "tag-3"] {
        let error = refused(set, "episode_limit", Setting::Whole(7));
        assert!(error.starts_with(&format!("no set `{set}`; there are `treasure-N`")), "{error}");
    }
}
