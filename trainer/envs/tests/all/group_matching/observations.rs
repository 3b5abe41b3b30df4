//! Rows, their names, and what an oracle is told.

use sortie_envs::group_matching::{GroupMatching, Parameters, columns, feature_names, write_row};
use sortie_envs::{EntitySet, Environment, Observation};

use super::for_random_states;

#[test]
fn rows_say_cell_groups_and_agent() {
    let names = feature_names(&Parameters::named("3x2x2").unwrap());
    let want = ["cell 0", "cell 1", "group 0", "group 1", "agent 0", "agent 1", "agent 2"];
    assert_eq!(names, want);
    for_random_states(3, |world, label| {
        let (parameters, ring) = (world.parameters(), world.ring(0));
        let mut row = vec![f32::NAN; parameters.features()];
        for agent in 0..parameters.agents {
            write_row(parameters, ring, agent, &mut row);
            let (cell, rest) = row.split_at(parameters.cells);
            let (groups, index) = rest.split_at(parameters.groups);
            let one_hot = |part: &[f32], place: usize| {
                part.iter().enumerate().all(|(at, x)| *x == f32::from(u8::from(at == place)))
            };
            assert!(one_hot(cell, ring.cells[agent].into()) && one_hot(index, agent), "{label}");
            for (members, flag) in ring.groups().zip(groups) {
                assert_eq!(*flag, f32::from((members >> agent & 1) as u8), "{label}");
            }
            let ones = (0..row.len()).filter(|column| row[*column] == 1.0);
            assert!(columns(parameters, ring, agent).eq(ones), "{label}");
        }
    });
}

#[test]
fn an_oracle_knows_the_first_group_of_every_agent() {
    for_random_states(5, |world, label| {
        let (ring, steps) = (world.ring(0), world.metrics(0).steps);
        let parameters = Parameters { groups_known_at_first: true, ..*world.parameters() };
        let forgetful = GroupMatching::new(parameters, 1).unwrap();
        let mut state = Vec::new();
        world.save(0, &mut state);
        let [known, at_first] = [world, &forgetful].map(|world| {
            let mut companions = vec![0; ring.cells.len()];
            assert!(world.companions(&state, &mut companions), "{label}");
            companions
        });
        for agent in 0..ring.cells.len() {
            let group = ring.groups().find(|members| members >> agent & 1 == 1);
            assert_eq!(group, Some(known[agent]), "{label}");
            let everybody = u128::MAX >> (128 - ring.cells.len());
            assert_eq!(at_first[agent], if steps == 0 { known[agent] } else { everybody });
        }
    });
}

#[test]
fn everybody_observes_everybody() {
    for_random_states(3, |world, label| {
        let (parameters, ring) = (world.parameters(), world.ring(0));
        let mut state = Vec::new();
        world.save(0, &mut state);
        let mut seen = Observation::new(&world.spec().shape);
        world.observe(&state, 0, EntitySet::MAX, &mut seen);
        assert_eq!(seen.agents(), parameters.agents);
        assert!(seen.observable.iter().all(|observed| *observed == seen.present), "{label}");
        assert!(seen.available.iter().all(|available| *available == 0b111), "{label}");
        let (mut dense, mut row) =
            (vec![0.0; parameters.features()], vec![0.0; parameters.features()]);
        for agent in 0..parameters.agents {
            seen.rows.write_dense(agent, &mut dense);
            write_row(parameters, ring, agent, &mut row);
            assert_eq!(dense, row, "{label}");
        }
    });
}
