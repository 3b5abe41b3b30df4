use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    AllocationRule, RELATIONS, SET_NAMES, availability_code, potential, scripted_actions,
    write_relation,
};
use sortie_envs::{
    ENVIRONMENTS, EntitySet, Environment, EnvironmentError, SparseRows, Split, conformance, open,
};

use super::{environment, for_random_states};

#[test]
fn every_environment_holds_to_the_laws_in_every_set() {
    for entry in ENVIRONMENTS {
        for set in (entry.sets)() {
            let name = format!("{}/{set}", entry.name);
            let environment = open(&name, Split::Train, 1, &Default::default()).unwrap();
            assert_eq!(environment.spec().name, entry.name);
            // Some sets have no subtasks to allocate.
            let rules = if environment.spec().shape.tasks > 0 { entry.rules } else { &[] };
            assert_eq!(environment.spec().rules, rules, "{name}");
            let relates = environment.spec().relations > 0;
            assert!(entry.reader.is_some() || !relates, "{name}: relations need frames");
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

#[test]
fn rules_scripts_and_distances_are_the_same_from_a_state_and_from_its_bytes() {
    for_random_states(1, |world, label| {
        let (city, shape) = (world.city(0), world.shape());
        let mut state = Vec::new();
        world.save(0, &mut state);

        let rules =
            [AllocationRule::Coordinated, AllocationRule::Heuristic, AllocationRule::Random];
        let (mut want, mut got) = ([7; 64], [7; 64]);
        for (rule, known) in rules.into_iter().enumerate() {
            known.allocate(city, &mut generator(1), &mut want);
            world.allocate(rule, &state, &mut generator(1), &mut got);
            assert_eq!(got, want, "{label}: {}", world.spec().rules[rule].name);
        }
        let (mut script, mut actions) = ([0; 64], [0; 64]);
        scripted_actions(city, &want, &mut generator(2), &mut script);
        assert!(world.scripted(&state, &got, &mut generator(2), &mut actions));
        assert_eq!(actions, script, "{label}");

        for task in [None, Some(0), Some(city.buildings.len() - 1)] {
            let near = potential(0.5, city, [0, 1].into_iter(), task);
            assert_eq!(world.potential(&state, 0.5, 0b11, task), near, "{label}: {task:?}");
        }
        for (agent, known) in city.agents.iter().enumerate() {
            for action in 0..shape.actions {
                let code = availability_code(known, action);
                if code > 0 {
                    let subtask = usize::from(code).checked_sub(2);
                    assert_eq!(world.subtask_of(&state, agent, action as u16), subtask, "{label}");
                }
            }
        }
        let rows: Vec<usize> = (0..city.agents.len()).collect();
        let (mut dense, mut sparse) =
            (vec![0.0; shape.entities * RELATIONS], SparseRows::default());
        write_relation(city, 0, &rows, shape.agents, &mut dense);
        world.relate(&state, 0, 0, EntitySet::MAX, &mut sparse);
        let buildings = (0..city.buildings.len()).map(|task| shape.agents + task);
        for (row, entity) in rows.into_iter().chain(buildings).enumerate() {
            let mut own = [0.0; RELATIONS];
            sparse.write_dense(row, &mut own);
            assert_eq!(own, dense[entity * RELATIONS..][..RELATIONS], "{label}: entity {entity}");
        }
    });
}
