//! Agents that remember become plans that remember as their graph does.

use serde_json::Value;
use sortie_bundle::OwnedObservation;
use sortie_compiler::{GraphPolicy, compile, inspect_onnx};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{DecideError, EntityMask, PlanPolicy, Policy};
use sortie_plans::{CompileError, CompileOptions, inspect_plan, random_observations};

use crate::support::beside_truth;

fn golden(path: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/");
    std::fs::read(format!("{root}{path}")).unwrap()
}

fn compiled(onnx: &[u8], features: Option<usize>) -> AlignedBytes {
    let options = CompileOptions { n_max: 11, features, ..CompileOptions::default() };
    AlignedBytes::copy_of(&compile(onnx, &options).unwrap().bytes)
}

/// One recorded step: what an agent saw and remembered, and what came of it.
struct Step {
    observation: OwnedObservation,
    before: Vec<f32>,
    utilities: Vec<f64>,
    after: Vec<f64>,
}

/// The recorded steps of present agents. The file's masks are the reference's: 1 = blocked, absent.
///
/// Its last four columns, last actions, are any numbers: they are features here.
fn recorded() -> Vec<Step> {
    let file: Value = serde_json::from_slice(&golden("networks/agent_gru_attn.json")).unwrap();
    let case = &file["cases"][0];
    let tensor = |part: &str, name: &str| -> Vec<f64> {
        let data = case[part][name]["data"].as_array().unwrap();
        data.iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let rows = tensor("inputs", "entities");
    let (hidden, absent) = (tensor("inputs", "obs_mask"), tensor("inputs", "entity_mask"));
    let first = tensor("inputs", "hidden0");
    let (utilities, states) = (tensor("outputs", "q"), tensor("outputs", "hidden"));
    let (agents, entities, columns, size, actions) = (3, 6, 9, 8, 4);
    let mut steps = Vec::new();
    for frame in 0..9 {
        for agent in (0..agents).filter(|agent| absent[frame * entities + agent] == 0.0) {
            let rows = &rows[frame * entities * columns..][..entities * columns];
            let mut visible = EntityMask::EMPTY;
            let row = &hidden[(frame * entities + agent) * entities..];
            for entity in (0..entities).filter(|entity| row[*entity] == 0.0) {
                visible.insert(entity);
            }
            let state = |all: &[f64], at: usize| all[at * size..][..size].to_vec();
            // Three steps of three trajectories: the first starts from the recorded state.
            let before = match frame % 3 {
                0 => state(&first, frame / 3 * agents + agent),
                _ => state(&states, (frame - 1) * agents + agent),
            };
            let observation = OwnedObservation {
                rows: rows.iter().map(|value| *value as f32).collect(),
                features: columns,
                last_actions: Vec::new(),
                visible,
                self_index: agent,
                available: vec![1; actions],
            };
            let at = frame * agents + agent;
            steps.push(Step {
                observation,
                before: before.iter().map(|value| *value as f32).collect(),
                utilities: utilities[at * actions..][..actions].to_vec(),
                after: state(&states, at),
            });
        }
    }
    steps
}

#[test]
fn the_recorded_agent_gives_its_recorded_utilities_and_states() {
    let onnx = golden("onnx/agent_gru_small.onnx");
    let plan = compiled(&onnx, Some(9));
    let plan = Plan::load(plan.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut plan = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let mut tract = GraphPolicy::by_tract(&onnx, 9).unwrap();
    let steps = recorded();
    assert!(steps.len() > 15, "{}", steps.len());
    for (index, step) in steps.iter().enumerate() {
        for (name, policy) in [("plan", &mut plan as &mut dyn Policy), ("tract", &mut tract)] {
            let (mut state, mut got) = (step.before.clone(), [0.0; 4]);
            policy.utilities_with(&step.observation.view(), &mut state, &mut got).unwrap();
            let pairs = got.iter().zip(&step.utilities).chain(state.iter().zip(&step.after));
            for (got, want) in pairs {
                let error = (f64::from(*got) - want).abs() / (1.0 + want.abs());
                assert!(error < 1e-6, "{name}, step {index}: {got}, want {want}");
            }
        }
    }
}

#[test]
fn plan_and_graph_stay_together_over_an_episode() {
    for (file, features, size) in [("agent_gru_small", 5, 8), ("agent_gru_odd_sizes", 7, 9)] {
        let onnx = golden(&format!("onnx/{file}.onnx"));
        let plan = compiled(&onnx, None);
        let plan = Plan::load(plan.as_slice()).unwrap();
        let actions = plan.actions();
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        let mut plan = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
        let mut tract = GraphPolicy::by_tract(&onnx, features).unwrap();
        assert_eq!((plan.hidden(), tract.hidden()), (size, size));
        let (mut got_state, mut want_state) = (vec![0.0; size], vec![0.0; size]);
        for observation in random_observations(100, 11, features, actions, 5) {
            let (mut got, mut want) = (vec![0.0; actions], vec![0.0; actions]);
            plan.utilities_with(&observation.view(), &mut got_state, &mut got).unwrap();
            tract.utilities_with(&observation.view(), &mut want_state, &mut want).unwrap();
            for (got, want) in got.iter().zip(&want).chain(got_state.iter().zip(&want_state)) {
                assert!((got - want).abs() < 1e-5, "{file}: {got}, want {want}");
            }
        }
        assert!(want_state.iter().any(|value| value.abs() > 0.01));
    }
}

#[test]
fn the_report_names_the_unit_and_its_state() {
    let onnx = golden("onnx/agent_gru_small.onnx");
    let report = compile(&onnx, &CompileOptions::default()).unwrap().report;
    let names: Vec<&str> = report.operators.iter().map(|op| op.name.as_str()).collect();
    assert_eq!(names, ["EmbedEntities", "AttendOwn", "Dense", "Gru", "Dense", "MaskedArgmax"]);
    assert_eq!(report.operators[3].detail, "[8], state [8]");
    assert!(report.max_distance < 6.0, "{report:?}");
    let plan = inspect_plan(compiled(&onnx, None).as_slice()).unwrap();
    assert_eq!((plan.hidden, plan.features, plan.actions), (8, 5, 4));
    let facts = inspect_onnx(&onnx).unwrap();
    assert_eq!(facts.metadata["sortie.hidden"], "8");
    let observations = random_observations(100, 11, 5, 4, 9);
    let comparison = beside_truth(compiled(&onnx, None).as_slice(), &onnx, observations);
    assert!(comparison.agrees() && comparison.max_rel_error < 1e-6, "{comparison:?}");
}

#[test]
fn tract_asks_for_the_state_too() {
    let mut tract = GraphPolicy::by_tract(&golden("onnx/agent_gru_small.onnx"), 5).unwrap();
    let observation = &random_observations(1, 11, 5, 4, 1)[0];
    let refused = |got| Err(DecideError::HiddenState { want: 8, got });
    assert_eq!(tract.decide(&observation.view()), refused(0));
    let unknown = tract.utilities(&observation.view(), &mut [0.0; 4]);
    assert_eq!(unknown, Err(DecideError::HiddenState { want: 8, got: 0 }));
    assert_eq!(tract.decide_with(&observation.view(), &mut [0.0; 7]), refused(7));
    assert!(tract.decide_with(&observation.view(), &mut [0.0; 8]).is_ok());
}

#[test]
fn a_unit_of_another_form_is_named_and_tract_still_runs_it() {
    let mut onnx = golden("onnx/agent_gru_small.onnx");
    let at = onnx.windows(6).position(|bytes| bytes == b"\x22\x04Tanh").unwrap();
    onnx[at + 2..at + 6].copy_from_slice(b"Sinh");
    let error = compile(&onnx, &CompileOptions::default()).map(|_| ());
    let Err(CompileError::Unsupported { node, operator, shapes, hint }) = error else {
        panic!("{error:?}");
    };
    assert_eq!((node.as_str(), operator.as_str()), ("gru.next", "Add"));
    assert_eq!(shapes, "f32 [8], f32 [8]");
    assert!(hint.contains("a recurrent unit is n + z (h - n)"), "{hint}");
    let mut tract = GraphPolicy::by_tract(&onnx, 5).unwrap();
    let observation = &random_observations(1, 11, 5, 4, 1)[0];
    assert!(tract.decide_with(&observation.view(), &mut [0.1; 8]).is_ok());
}

#[test]
fn metadata_says_that_actions_are_drawn() {
    let mut onnx = golden("onnx/agent_gru_small.onnx");
    // A further entry of the model's metadata; fields of a message may stand in any order.
    onnx.extend(b"\x72\x17\x0a\x0dsortie.choice\x12\x06sample");
    let plan = compiled(&onnx, None);
    let plan = Plan::load(plan.as_slice()).unwrap();
    assert!(plan.program().draws());
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let observation = &random_observations(1, 11, 5, 4, 1)[0];
    let mut state = [0.0; 8];
    let drawn = plan.sample(arena.as_mut_slice(), &observation.view(), Some(&mut state), 77);
    assert!(observation.available[usize::from(drawn.unwrap().action)] > 0);
    assert!(state.iter().any(|value| *value != 0.0));
}
