//! Plans before their judges, on all families of inputs.

use sortie_compiler::{Judge, compile, judge_agent, judge_team_values};
use sortie_plans::{
    Comparison, CompileOptions, Compiled, Family, ObservationSizes, TOLERANCE, TeamQuerySizes,
    observation_families, team_query_families,
};

const N_MAX: usize = 9;
/// With a skip and without.
const TEAM_VALUES: [&str; 2] = ["team_value_small", "team_value_skip_small"];

fn golden(name: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    std::fs::read(format!("{root}{name}.onnx")).unwrap()
}

fn compiled(onnx: &[u8]) -> Compiled {
    compile(onnx, &CompileOptions { n_max: N_MAX, inputs: 8, ..CompileOptions::default() }).unwrap()
}

/// Sizes of a recorded agent network, by its file's metadata.
fn agent(name: &str) -> (Vec<u8>, Compiled, ObservationSizes) {
    let onnx = golden(name);
    let plan = compiled(&onnx);
    let facts = sortie_plans::inspect_plan(&plan.bytes).unwrap();
    let sizes = ObservationSizes { n_max: N_MAX, features: facts.features, actions: facts.actions };
    (onnx, plan, sizes)
}

fn team_value(name: &str) -> (Vec<u8>, Compiled, TeamQuerySizes) {
    let onnx = golden(name);
    let plan = compiled(&onnx);
    let (features, relations) = sortie_compiler::TractTeamValue::new(&onnx).unwrap().columns();
    (onnx, plan, TeamQuerySizes { n_max: N_MAX, features, relations })
}

/// Every input is answered alike by both, or by neither.
fn assert_agreed(judge: Judge, compared: &[Comparison]) {
    for family in compared {
        let what = format!("{} on `{}`: {family:?}", judge.name(), family.name);
        assert!(family.agrees(), "{what}");
        if family.judged {
            let refuses = ["NaN", "infinities", "no available action"];
            let all = refuses.contains(&family.name.as_str());
            assert_eq!(family.refused, if all { family.inputs } else { 0 }, "{what}");
            assert_eq!(family.action_mismatches, 0, "{what}");
        }
    }
}

fn assert_agents_agree(judge: Judge) {
    for name in [
        "agent_small",
        "agent_one_head",
        "agent_eight_heads",
        "agent_odd_sizes",
        "agent_skip_small",
        "agent_skip_one_layer",
    ] {
        let (onnx, plan, sizes) = agent(name);
        let families = observation_families(64, sizes, 3);
        assert_agreed(judge, &judge_agent(&plan.bytes, &onnx, judge, &families).unwrap());
    }
}

fn assert_team_values_agree(judge: Judge) {
    for name in TEAM_VALUES {
        let (onnx, plan, sizes) = team_value(name);
        let families = team_query_families(64, sizes, 3);
        assert_agreed(judge, &judge_team_values(&plan.bytes, &onnx, judge, &families).unwrap());
    }
}

#[test]
fn agents_agree_with_tract_on_every_family() {
    assert_agents_agree(Judge::Tract);
}

#[test]
fn team_values_agree_with_tract_on_every_family() {
    assert_team_values_agree(Judge::Tract);
}

#[test]
fn a_plan_of_another_network_is_found_out() {
    let (onnx, _, sizes) = agent("agent_small");
    // The same inputs and outputs, other weights.
    let (_, other, _) = agent("agent_one_head");
    let families = observation_families(64, sizes, 3);
    let compared = judge_agent(&other.bytes, &onnx, Judge::Tract, &families).unwrap();
    let random = compared.iter().find(|family| family.name == "random").unwrap();
    assert!(random.max_rel_error > TOLERANCE, "{random:?}");
}

mod onnxruntime {
    use sortie_bundle::OwnedObservation;
    use sortie_compiler::onnxruntime::{
        BatchedAgents, BatchedTeamValues, OnnxRuntime, OnnxRuntimePolicy, OnnxRuntimeTeamValue,
        find_library,
    };
    use sortie_core::Policy;
    use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
    use sortie_plans::OwnedTeamQuery;

    use super::*;

    fn runtime() -> &'static OnnxRuntime {
        let runtime = find_library(None).and_then(|library| OnnxRuntime::load(&library));
        runtime.unwrap_or_else(|error| {
            panic!(
                "{error}: `python3 -m venv target/onnxruntime && target/onnxruntime/bin/pip install onnxruntime`, then \
                 `export VIRTUAL_ENV=$PWD/target/onnxruntime`"
            )
        })
    }

    fn inputs<T>(families: Vec<Family<T>>, name: &str) -> Vec<T> {
        families.into_iter().find(|family| family.name == name).unwrap().inputs
    }

    fn assert_near(got: &[f32], want: &[f32]) {
        let largest = want.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() <= TOLERANCE * (1.0 + largest), "{got} {want}");
        }
    }

    #[test]
    fn networks_agree_with_onnxruntime_on_every_family() {
        let runtime = runtime();
        assert_agents_agree(Judge::OnnxRuntime(runtime));
        assert_team_values_agree(Judge::OnnxRuntime(runtime));
    }

    #[test]
    fn a_batched_call_gives_what_single_calls_give() {
        let runtime = runtime();
        for name in ["agent_small", "agent_skip_small", "agent_skip_one_layer"] {
            assert_batched_agents_agree(runtime, name);
        }
    }

    fn assert_batched_agents_agree(runtime: &OnnxRuntime, name: &str) {
        let (onnx, _, sizes) = agent(name);
        let mut single = OnnxRuntimePolicy::new(runtime, &onnx, sizes.features).unwrap();
        let mut batched = BatchedAgents::new(runtime, &onnx, sizes.features).unwrap();
        let masks = inputs(observation_families(32, sizes, 5), "n_max entities");
        for (agents, frame) in masks.windows(3).enumerate() {
            // Three agents of one frame: the rows of the first, the masks of each.
            let seen = |(row, mask): (usize, &OwnedObservation)| OwnedObservation {
                visible: mask.visible,
                self_index: (agents + row) % N_MAX,
                ..frame[0].clone()
            };
            let frame: Vec<OwnedObservation> = frame.iter().enumerate().map(seen).collect();
            let views: Vec<_> = frame.iter().map(OwnedObservation::view).collect();
            let mut got = vec![0.0; 3 * sizes.actions];
            batched.utilities(&views, &mut got).unwrap();
            for (view, got) in views.iter().zip(got.chunks_exact(sizes.actions)) {
                let mut want = vec![0.0; sizes.actions];
                single.utilities(view, &mut want).unwrap();
                assert_near(got, &want);
            }
        }
    }

    #[test]
    fn a_batched_call_values_all_teams_of_a_state() {
        let runtime = runtime();
        TEAM_VALUES.iter().for_each(|name| assert_batched_team_values_agree(runtime, name));
    }

    fn assert_batched_team_values_agree(runtime: &OnnxRuntime, name: &str) {
        let (onnx, _, sizes) = team_value(name);
        let mut single = OnnxRuntimeTeamValue::new(runtime, &onnx).unwrap();
        let mut batched = BatchedTeamValues::new(runtime, &onnx).unwrap();
        for query in inputs(team_query_families(16, sizes, 5), "n_max entities") {
            let OwnedTeamQuery { state, task, relation, .. } = &query;
            let state = state.view();
            let team = |team| TeamQuery { state: &state, task: *task, team, relation };
            let queries: Vec<TeamQuery<'_>> = (0..8).map(team).collect();
            let mut got = vec![0.0; queries.len()];
            batched.values(&queries, &mut got).unwrap();
            let want: Vec<f32> = queries.iter().map(|query| single.value(query).unwrap()).collect();
            assert_near(&got, &want);
        }
    }
}
