//! Rows, their names, and what an oracle is told.

use sortie_envs::group_matching::{
    KnownGroups, Parameters, columns, feature_names, same_group, write_row,
};

use super::{for_random_states, ring};

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
        for agent in 0..ring.cells.len() {
            let known = same_group(ring, steps, KnownGroups::Always, agent);
            assert_eq!(known >> agent & 1, 1, "{label}");
            assert_eq!(ring.groups().find(|members| members >> agent & 1 == 1), Some(known));
            let at_first = same_group(ring, steps, KnownGroups::AtFirst, agent);
            let everybody = u128::MAX >> (128 - ring.cells.len());
            assert_eq!(at_first, if steps == 0 { known } else { everybody }, "{label}");
        }
    });
}

#[test]
fn the_reward_loop_runs_whole_episodes() {
    let mut world = ring("8x6x2");
    let mut random = sortie_envs::random::generator(1);
    world.reset(0, &mut random);
    let mut rows = vec![0.0; 8 * 16];
    let returns =
        sortie_envs::group_matching::observe_and_step(&mut world, &mut rows, &mut random, 500);
    assert!((-80.0..-20.0).contains(&returns), "{returns}");
}
