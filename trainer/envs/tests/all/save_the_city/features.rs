//! Rows rebuilt from compact states, and what an observation holds.

use std::collections::HashSet;

use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    ACTION_NAMES, FEATURE_NAMES, FEATURES, write_agent_row, write_building_row,
};
use sortie_envs::{EntitySet, Environment, Observation};

use super::{environment, for_random_states, observed};

fn row(seen: &Observation, entity: usize) -> [f32; FEATURES] {
    let mut row = [7.0; FEATURES];
    seen.rows.write_dense(seen.row_of(entity), &mut row);
    row
}

#[test]
fn rows_rebuilt_from_states_equal_the_observed_ones() {
    for_random_states(1, |city, label| {
        let shape = city.shape();
        let seen = observed(city);
        let mut rebuilt = [7.0; FEATURES];
        for (index, agent) in city.city(0).agents.iter().enumerate() {
            write_agent_row(agent, &mut rebuilt);
            assert_eq!(rebuilt, row(&seen, index), "{label}");
        }
        for (index, building) in city.city(0).buildings.iter().enumerate() {
            let entity = shape.agents + index;
            write_building_row(building, &mut rebuilt);
            assert_eq!(rebuilt, row(&seen, entity), "{label}");
            let mut narrowed = *building;
            (narrowed.health, narrowed.fire) =
                (f64::from(building.health as f32), f64::from(building.fire as f32));
            write_building_row(&narrowed, &mut rebuilt);
            assert_eq!(rebuilt, row(&seen, entity), "{label}: health and fire kept as f32");
        }
    });
}

#[test]
fn an_observation_shows_those_that_exist() {
    let mut city = environment("2-5a_2-5b", 1);
    let shape = city.shape();
    assert_eq!((shape.agents, shape.entities, shape.tasks), (5, 11, 6));
    assert_eq!((shape.actions, shape.features), (12, 58));
    for tasks in 3..=6 {
        city.reset_with_tasks(0, tasks, &mut generator(2)).unwrap();
        let seen = observed(&city);
        let agents = tasks - 1;
        let present = |entity: usize| entity < agents || (5..5 + tasks).contains(&entity);
        assert_eq!(seen.rows.len(), agents + tasks);
        for entity in 0..11 {
            assert_eq!(seen.present >> entity & 1 == 1, present(entity));
            let own = if entity < 5 { 0 } else { u128::from(present(entity)) << (entity - 5) };
            assert_eq!(seen.entity_task[entity], own);
        }
        for agent in 0..5 {
            assert_eq!(seen.observable[agent], if agent < agents { seen.present } else { 0 });
            assert_eq!(seen.available[agent] & 1, 1);
            assert!(agent < agents || seen.available[agent] == 1);
        }
        assert_eq!(seen.open_tasks, (1 << tasks) - 1);
        assert_eq!(u128::from(city.open_tasks(0)), seen.open_tasks);
    }
}

#[test]
fn an_observation_forgets_the_one_before() {
    let mut city = environment("2-5a_2-5b", 1);
    let (mut state, mut seen) = (Vec::new(), Observation::default());
    for tasks in [6, 3] {
        city.reset_with_tasks(0, tasks, &mut generator(2)).unwrap();
        state.clear();
        city.save(0, &mut state);
        city.observe(&state, 0, EntitySet::MAX, &mut seen);
    }
    assert_eq!(seen, observed(&city));
}

#[test]
fn names_are_distinct() {
    assert_eq!(FEATURE_NAMES.iter().collect::<HashSet<_>>().len(), FEATURES);
    assert_eq!(ACTION_NAMES.iter().collect::<HashSet<_>>().len(), 12);
}
