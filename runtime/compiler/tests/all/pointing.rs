//! Agents whose head points at entities become plans that compute the same, in every profile.

use sortie_bundle::OwnedObservation;
use sortie_compiler::{GraphPolicy, compile};
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Profile};
use sortie_core::{EntityMask, NO_ACTION, Policy};
use sortie_plans::{CompileOptions, inspect_plan, random_observations};

use crate::support::beside_truth;

/// Its file, features, actions, and the first entity that is aimed at. The last is told of pairs.
const AGENTS: [(&str, usize, usize, usize); 3] = [
    ("agent_pointing_small", 6, 6, 2),
    ("agent_pointing_gru", 7, 4, 0),
    ("agent_pointing_pairs", 11, 6, 2),
];

fn golden(name: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    std::fs::read(format!("{root}{name}.onnx")).unwrap()
}

fn compiled(name: &str, n_max: usize, profile: Profile) -> AlignedBytes {
    let options = CompileOptions { n_max, profile, ..CompileOptions::default() };
    AlignedBytes::copy_of(&compile(&golden(name), &options).unwrap().bytes)
}

/// The profiles in f32 that this machine runs.
fn f32_profiles() -> &'static [Profile] {
    let all = &[Profile::Exact, Profile::Fused];
    if Build::widest().fuses() { all } else { &all[..1] }
}

#[test]
fn agents_agree_with_their_graphs_whatever_they_see() {
    for (name, features, actions, ..) in AGENTS {
        for (n_max, &profile) in [1, 2, 5, 11].into_iter().zip(f32_profiles().iter().cycle()) {
            let plan = compiled(name, n_max, profile);
            let mut observations = random_observations(70, n_max, features, actions, 5);
            for observation in observations.iter_mut().step_by(7) {
                observation.visible = EntityMask::EMPTY;
            }
            let got = beside_truth(plan.as_slice(), &golden(name), observations);
            assert!(got.agrees(), "{name} of {n_max}, {profile:?}: {got:?}");
        }
    }
}

#[test]
fn an_int8_agent_is_near_its_graph() {
    for (name, features, actions, ..) in [AGENTS[0], AGENTS[2]] {
        let plan = compiled(name, 9, Profile::Int8);
        let observations = random_observations(100, 9, features, actions, 5);
        let got = beside_truth(plan.as_slice(), &golden(name), observations);
        assert!(got.max_rel_error < 0.02, "{name}: {got:?}");
    }
}

/// What stands in rows that an agent does not see reaches no graph, although rows keep their numbers.
#[test]
fn numbers_that_are_none_in_hidden_rows_change_nothing() {
    for (name, features, actions, ..) in AGENTS {
        let mut graph = GraphPolicy::by_tract(&golden(name), features).unwrap();
        let mut hidden = vec![0.0; graph.hidden()];
        let mut ask = |seen: &OwnedObservation| {
            let mut utilities = vec![0.0; actions];
            hidden.fill(0.0);
            graph.utilities_with(&seen.view(), &mut hidden, &mut utilities).map(|()| utilities)
        };
        for mut seen in random_observations(20, 9, features, actions, 6) {
            let before = ask(&seen).unwrap();
            let (visible, own) = (seen.visible, seen.self_index);
            for (row, numbers) in seen.rows.chunks_exact_mut(features).enumerate() {
                if !visible.contains(row) && row != own {
                    numbers.fill(f32::NAN);
                }
            }
            assert_eq!(ask(&seen), Ok(before), "{name}");
        }
    }
}

/// Who is aimed at is what counts, not its number: targets that trade places trade utilities.
#[test]
fn targets_that_trade_places_trade_utilities() {
    for (name, features, actions, first) in [AGENTS[0], AGENTS[1]] {
        let mut graph = GraphPolicy::by_tract(&golden(name), features).unwrap();
        let mut hidden = vec![0.0; graph.hidden()];
        let scene = |order: [usize; 2]| OwnedObservation {
            rows: (0..8)
                .flat_map(|entity| {
                    let entity = match entity {
                        entity if entity == first + 1 => order[0],
                        entity if entity == first + 2 => order[1],
                        entity => entity,
                    };
                    (0..features).map(move |column| ((entity * 7 + column * 3) % 11) as f32 / 11.0)
                })
                .collect(),
            features,
            last_actions: vec![NO_ACTION; 1],
            visible: EntityMask::first(8),
            self_index: 0,
            available: vec![1; actions],
        };
        let mut ask = |seen: OwnedObservation| {
            let mut utilities = vec![0.0; actions];
            hidden.fill(0.0);
            graph.utilities_with(&seen.view(), &mut hidden, &mut utilities).unwrap();
            utilities
        };
        let (one, other) = (ask(scene([first + 1, first + 2])), ask(scene([first + 2, first + 1])));
        let aimed = actions - if first == 0 { 3 } else { 4 };
        let (a, b) = (aimed + 1, aimed + 2);
        assert!((one[a] - one[b]).abs() > 1e-3, "{name}: {one:?}");
        for (one, other) in [(one[a], other[b]), (one[b], other[a]), (one[0], other[0])] {
            assert!((one - other).abs() < 1e-5, "{name}: {one}, {other}");
        }
    }
}

#[test]
fn a_plan_that_points_names_its_targets() {
    for (name, detail) in [
        (AGENTS[0].0, "[N, 16] -> [4] of [6]"),
        (AGENTS[1].0, "[N, 20] -> [3] of [4]"),
        (AGENTS[2].0, "[N, 16] and [4, 2] -> [4] of [6]"),
    ] {
        let facts = inspect_plan(compiled(name, 9, Profile::Exact).as_slice()).unwrap();
        let found = facts.operators.iter().find(|op| op.name == "PointAtEntities").unwrap();
        assert_eq!(found.detail, detail);
    }
}
