//! Plans before their judges, on all families of inputs.

use sortie_compiler::{GraphTeamValue, LinkedEngines, compile};
use sortie_plans::{
    Answer, Comparison, CompileOptions, Compiled, Engines, Family, GraphEngine, MOST_DISTANCE,
    NetworkFiles, NetworkInput, ObservationSizes, Standard, TOLERANCE, TeamQuerySizes, True,
    compare, compare_with_truth, inspect_plan, observation_families, plan_answers,
    team_query_families,
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
    let facts = inspect_plan(&plan.bytes).unwrap();
    let sizes = ObservationSizes { n_max: N_MAX, features: facts.features, actions: facts.actions };
    (onnx, plan, sizes)
}

fn team_value(name: &str) -> (Vec<u8>, Compiled, TeamQuerySizes) {
    let onnx = golden(name);
    let plan = compiled(&onnx);
    let (features, relations) = GraphTeamValue::by_tract(&onnx).unwrap().columns();
    (onnx, plan, TeamQuerySizes { n_max: N_MAX, features, relations })
}

/// A plan beside an engine and beside the truth, on every family.
fn judged<T: Clone + Into<NetworkInput>>(
    (plan, onnx): (&[u8], &[u8]),
    engine: &dyn GraphEngine,
    families: &[Family<T>],
) -> Vec<[Comparison; 2]> {
    let (files, features) = (NetworkFiles::One(onnx), inspect_plan(plan).unwrap().features);
    let mut graph = engine.network(&files, features).unwrap();
    let mut truth = LinkedEngines.true_network(&files, features, 1).unwrap();
    let mut judge = |family: &Family<T>| {
        let mut family = family.clone().map(Into::into);
        let got = plan_answers(plan, &mut family.inputs, 1).unwrap();
        let want = |input: &NetworkInput| graph.answer(input, family.rows).ok();
        let want: Vec<Option<Answer>> = family.inputs.iter().map(want).collect();
        let truths = match family.standard {
            Standard::Same => {
                let truth = |input: &NetworkInput| truth.answer(input, family.rows).ok();
                family.inputs.iter().map(truth).collect()
            }
            _ => Vec::<Option<True>>::new(),
        };
        [compare(&family, &got, &want, &truths), compare_with_truth(&family, &got, &truths)]
    };
    families.iter().map(&mut judge).collect()
}

/// Every input is answered alike by both, or by neither.
fn assert_agreed(compared: &[[Comparison; 2]]) {
    for family in compared.iter().flatten() {
        let what = format!("{family:?}");
        assert!(family.agrees(), "{what}");
        if family.judged {
            let refuses = ["NaN", "infinities", "no available action"];
            let all = refuses.contains(&family.name.as_str());
            assert_eq!(family.refused, if all { family.inputs } else { 0 }, "{what}");
            assert_eq!(family.action_mismatches, 0, "{what}");
        }
    }
}

fn assert_agents_agree(engine: &dyn GraphEngine) {
    for name in [
        "agent_small",
        "agent_one_head",
        "agent_eight_heads",
        "agent_odd_sizes",
        "agent_skip_small",
        "agent_skip_one_layer",
    ] {
        let (onnx, plan, sizes) = agent(name);
        assert_agreed(&judged((&plan.bytes, &onnx), engine, &observation_families(32, sizes, 3)));
    }
}

fn assert_team_values_agree(engine: &dyn GraphEngine) {
    for name in TEAM_VALUES {
        let (onnx, plan, sizes) = team_value(name);
        assert_agreed(&judged((&plan.bytes, &onnx), engine, &team_query_families(32, sizes, 3)));
    }
}

#[test]
fn agents_agree_with_tract_and_the_truth_on_every_family() {
    assert_agents_agree(LinkedEngines.tract());
}

#[test]
fn team_values_agree_with_tract_and_the_truth_on_every_family() {
    assert_team_values_agree(LinkedEngines.tract());
}

#[test]
fn a_plan_of_another_network_is_found_out() {
    let (onnx, _, sizes) = agent("agent_small");
    // The same inputs and outputs, other weights.
    let (_, other, _) = agent("agent_one_head");
    let families = observation_families(64, sizes, 3);
    let compared = judged((&other.bytes, &onnx), LinkedEngines.tract(), &families);
    for random in compared.iter().flatten().filter(|family| family.name == "random") {
        assert!(random.max_distance.is_some_and(|far| far > 100.0 * MOST_DISTANCE), "{random:?}");
        assert!(!random.agrees());
    }
}

mod onnxruntime {
    use sortie_bundle::OwnedObservation;
    use sortie_compiler::onnxruntime::{OnnxRuntime, find_library};
    use sortie_compiler::{BatchedAgents, BatchedTeamValues, GraphPolicy};
    use sortie_core::Policy;
    use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
    use sortie_plans::{BatchedUtilities, BatchedValues, OwnedTeamQuery};

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
        assert_agents_agree(runtime);
        assert_team_values_agree(runtime);
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
        let mut single = GraphPolicy::by_onnxruntime(runtime, &onnx, sizes.features).unwrap();
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
        let mut single = GraphTeamValue::by_onnxruntime(runtime, &onnx).unwrap();
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
