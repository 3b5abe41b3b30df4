//! Networks whose own row skips the attention become plans that compute the same, in every profile.

use sortie_compiler::{GraphPolicy, GraphTeamValue, compile};
use sortie_core::allocate::{PlanTeamValue, TeamValueNetwork};
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{EntityMask, PlanPolicy, Policy};
use sortie_plans::{CompileOptions, inspect_plan, random_observations, random_team_queries};

use crate::support::beside_truth;

const AGENT: &str = "agent_skip_small";
const ONE_LAYER: &str = "agent_skip_one_layer";
const RECURRENT: &str = "agent_gru_skip_odd_sizes";
const TEAM_VALUE: &str = "team_value_skip_small";

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
    for (name, features, actions) in [(AGENT, 6, 4), (ONE_LAYER, 7, 5), (RECURRENT, 7, 3)] {
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
    for (name, features, actions) in [(AGENT, 6, 4), (ONE_LAYER, 7, 5)] {
        let plan = compiled(name, 9, Profile::Int8);
        let observations = random_observations(100, 9, features, actions, 5);
        let got = beside_truth(plan.as_slice(), &golden(name), observations);
        assert!(got.max_rel_error < 0.02, "{name}: {got:?}");
    }
}

#[test]
fn an_agent_that_sees_nothing_decides_by_its_own_row() {
    for profile in [Profile::Exact, Profile::Int8] {
        let bytes = compiled(AGENT, 5, profile);
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
        let mut tract = GraphPolicy::by_tract(&golden(AGENT), 6).unwrap();
        let mut answers = Vec::new();
        for mut observation in random_observations(20, 5, 6, 4, 9) {
            observation.visible = EntityMask::EMPTY;
            let (mut got, mut want) = ([0.0; 4], [0.0; 4]);
            policy.utilities(&observation.view(), &mut got).unwrap();
            tract.utilities(&observation.view(), &mut want).unwrap();
            for (got, want) in got.iter().zip(want) {
                assert!((got - want).abs() < 0.02 * (1.0 + want.abs()), "{got}, want {want}");
            }
            answers.push(got.map(f32::to_bits));
        }
        answers.sort_unstable();
        answers.dedup();
        assert!(answers.len() > 10, "{answers:?}");
    }
}

#[test]
fn values_of_teams_agree_one_by_one_and_together() {
    let onnx = golden(TEAM_VALUE);
    let bytes = compiled(TEAM_VALUE, 9, Profile::Exact);
    let queries = random_team_queries(600, 9, 6, 3, 17);
    let got = beside_truth(bytes.as_slice(), &onnx, queries[..150].to_vec());
    assert!(got.agrees() && got.max_rel_error < 1e-6, "{got:?}");
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(4));
    let mut rows = vec![f32::NAN; PlanTeamValue::memory_floats(&plan, 32)];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows).unwrap();
    let mut tract = GraphTeamValue::by_tract(&onnx).unwrap();
    for query in &queries[..60] {
        let state = query.state.view();
        let view = query.view(&state);
        let teams = [view.team, 0, view.team & 1];
        let (mut got, mut want) = ([0.0; 3], [0.0; 3]);
        network.values(&view, &teams, &mut got).unwrap();
        tract.values(&view, &teams, &mut want).unwrap();
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-5 * (1.0 + want.abs()), "{got}, want {want}");
        }
    }
}

#[test]
fn a_plan_with_a_skip_names_it() {
    for name in [AGENT, ONE_LAYER, RECURRENT, TEAM_VALUE] {
        let plan = compiled(name, 9, Profile::Exact);
        assert_eq!(plan.as_slice()[124], 1, "{name}");
        let facts = inspect_plan(plan.as_slice()).unwrap();
        let attention = &facts.operators[1];
        assert_eq!(attention.name, "AttendOwn");
        assert!(attention.detail.ends_with(", skip, relu"), "{}", attention.detail);
    }
    let int8 = compiled(AGENT, 9, Profile::Int8);
    assert_eq!(int8.as_slice()[124], 1);
    let without = compiled("agent_small", 9, Profile::Exact);
    assert_eq!(without.as_slice()[124], 0);
}
