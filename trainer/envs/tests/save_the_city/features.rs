//! Rows rebuilt from compact states, and what an observation holds.

use std::collections::HashSet;

use sortie_envs::save_the_city::{
    ACTION_NAMES, FEATURE_NAMES, FEATURES, SparseRow, write_agent_row, write_building_row,
};
use sortie_envs::{Environment, ObservationBuffers, Subtasks};

use super::{environment, for_random_states};

/// A row from its non-zero columns.
fn dense(row: &SparseRow) -> Vec<f32> {
    let mut dense = vec![0.0; FEATURES];
    for (column, value) in row.entries() {
        assert_ne!(value, 0.0);
        dense[column] = value;
    }
    dense
}

#[test]
fn rows_rebuilt_from_states_equal_the_observed_ones() {
    for_random_states(1, |city, label| {
        let shape = city.shape();
        let mut buffers = ObservationBuffers::new(&shape);
        city.observe(0, &mut buffers.lend());
        let observed = |entity: usize| &buffers.rows[entity * FEATURES..][..FEATURES];
        let mut row = [7.0; FEATURES];
        for (index, agent) in city.city(0).agents.iter().enumerate() {
            write_agent_row(agent, &mut row);
            assert_eq!(row, observed(index), "{label}");
            assert_eq!(dense(&SparseRow::of_agent(agent)), observed(index), "{label}");
        }
        for (index, building) in city.city(0).buildings.iter().enumerate() {
            let entity = shape.agents + index;
            write_building_row(building, &mut row);
            assert_eq!(row, observed(entity), "{label}");
            assert_eq!(dense(&SparseRow::of_building(building)), observed(entity), "{label}");
            let mut narrowed = *building;
            (narrowed.health, narrowed.fire) =
                (f64::from(building.health as f32), f64::from(building.fire as f32));
            write_building_row(&narrowed, &mut row);
            assert_eq!(row, observed(entity), "{label}: health and fire kept as f32");
        }
    });
}

#[test]
fn an_observation_fills_every_buffer_and_leaves_agents_tasks_alone() {
    let mut city = environment("2-5a_2-5b", 1);
    let shape = city.shape();
    assert_eq!((shape.agents, shape.entities, shape.tasks), (5, 11, 6));
    assert_eq!((shape.actions, shape.features), (12, 58));
    for tasks in 3..=6 {
        city.reset_with_tasks(0, tasks).unwrap();
        let mut buffers = ObservationBuffers::with_stride(&shape, 70);
        buffers.rows.fill(9.0);
        buffers.entity_task.fill(9);
        buffers.available.fill(9);
        buffers.observable.fill(9);
        city.observe(0, &mut buffers.lend());

        let agents = tasks - 1;
        let present = |entity: usize| entity < agents || (5..5 + tasks).contains(&entity);
        for entity in 0..11 {
            assert_eq!(buffers.present >> entity & 1 == 1, present(entity));
            let row = &buffers.rows[entity * 70..][..70];
            assert_eq!(row[..58].iter().any(|&value| value != 0.0), present(entity));
            assert!(row[58..].iter().all(|&value| value == 9.0));
            let own = if entity < 5 { 9 } else { u32::from(present(entity)) << (entity - 5) };
            assert_eq!(buffers.entity_task[entity], own);
        }
        for agent in 0..5 {
            let seen = if agent < agents { buffers.present } else { 0 };
            assert_eq!(buffers.observable[agent], seen);
            let codes = &buffers.available[agent * 12..][..12];
            assert_eq!(codes[0], 1);
            assert!(agent < agents || codes[1..].iter().all(|&code| code == 0));
        }
        assert_eq!(buffers.open_tasks, (1 << tasks) - 1);
        assert_eq!(city.open_tasks(0), buffers.open_tasks);
    }
}

#[test]
fn names_are_distinct() {
    assert_eq!(FEATURE_NAMES.iter().collect::<HashSet<_>>().len(), FEATURES);
    assert_eq!(ACTION_NAMES.iter().collect::<HashSet<_>>().len(), 12);
}
