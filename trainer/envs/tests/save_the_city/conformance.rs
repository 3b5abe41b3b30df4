use sortie_envs::save_the_city::SET_NAMES;
use sortie_envs::{ENVIRONMENTS, EnvironmentError, Split, conformance, open};

use super::environment;

#[test]
fn every_environment_holds_to_the_laws_in_every_set() {
    for entry in ENVIRONMENTS {
        for set in (entry.sets)() {
            let name = format!("{}/{set}", entry.name);
            let environment = open(&name, Split::Train, 1, &Default::default()).unwrap();
            assert_eq!(environment.spec().name, entry.name);
            assert_eq!(conformance::check(&*environment, 3, 6), Ok(()), "{name}");
        }
    }
}

#[test]
fn a_state_of_another_layout_or_length_is_refused_by_name() {
    let mut city = environment(SET_NAMES[0], 1);
    let mut state = Vec::new();
    sortie_envs::Environment::save(&city, 0, &mut state);
    let mut load = |bytes: &[u8]| {
        let refused = sortie_envs::Environment::load(&mut city, 0, bytes);
        refused.map_err(|error| error.to_string())
    };
    assert_eq!(load(&state), Ok(()));
    let later = [&[9], &state[1..]].concat();
    assert_eq!(load(&later), Err("a state of layout 9; this build reads layout 1".into()));
    let cut = load(&state[..state.len() - 1]).unwrap_err();
    assert!(cut.contains("it should have"), "{cut}");
    let mut elsewhere = state.clone();
    elsewhere[61] = 16;
    let refused = load(&elsewhere).unwrap_err();
    assert!(refused.contains("agent 0 is off the map"), "{refused}");
}

#[test]
fn unknown_names_are_refused_with_those_that_there_are() {
    let refused = |name: &str| open(name, Split::Train, 1, &Default::default()).err().unwrap();
    assert!(refused("no-city").to_string().contains("there are `save-the-city`"));
    assert!(matches!(refused("save-the-city/none"), EnvironmentError::Set(_)));
    let setting = [("fire".to_string(), sortie_envs::registry::Setting::Whole(1))];
    let refused = open("save-the-city", Split::Train, 1, &setting.into()).err().unwrap();
    assert!(refused.to_string().contains("`fire`"), "{refused}");
}

#[test]
fn settings_reach_the_rules() {
    let setting = [("episode_limit".to_string(), sortie_envs::registry::Setting::Whole(7))];
    let city = open("save-the-city", Split::Train, 1, &setting.into()).unwrap();
    assert_eq!(city.spec().episode_limit, 7);
}
