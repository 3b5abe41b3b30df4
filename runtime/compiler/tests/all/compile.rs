//! Exported networks become plans that give the recorded answers.

use safetensors::SafeTensors;
use sortie_bundle::OwnedObservation;
use sortie_compiler::{GraphPolicy, compile, inspect_onnx};
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile, Proof};
use sortie_core::{EntityMask, NO_ACTION, PlanPolicy, Policy};
use sortie_plans::{CompileError, CompileOptions, Compiled, inspect_plan, random_observations};

use crate::support::beside_truth;

fn golden(path: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/");
    std::fs::read(format!("{root}{path}")).unwrap()
}

fn compiled(onnx: &[u8]) -> Compiled {
    compile(onnx, &CompileOptions { n_max: 11, ..CompileOptions::default() }).unwrap()
}

/// The recorded observations and utilities of the network at SaveTheCity's sizes.
///
/// The file's masks are the reference's: 1 = blocked, absent, not a member. Its rows end with last actions.
fn recorded() -> Vec<(OwnedObservation, Vec<f64>)> {
    let bytes = golden("networks/agent_ff_default.safetensors");
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let data = |name: &str| file.tensor(name).unwrap().data().to_vec();
    let (rows, wanted) = (data("in/entities"), data("out/q"));
    let floats = rows.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
    let floats: Vec<f32> = floats.collect();
    let wanted = wanted.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes));
    let wanted: Vec<f64> = wanted.collect();
    let (hidden, absent) = (data("in/obs_mask"), data("in/entity_mask"));
    let outside = data("in/entity2task_mask");
    let (agents, entities, tasks, columns, features, actions) = (5, 11, 6, 70, 58, 12);
    let mut cases = Vec::new();
    for frame in 0..4 {
        let rows = &floats[frame * entities * columns..][..entities * columns];
        let one_hot = |row: &[f32]| row[features..].iter().position(|&value| value == 1.0);
        let last = |row: &[f32]| one_hot(row).map_or(NO_ACTION, |action| action as u16);
        let member =
            |entity: usize, task: usize| outside[(frame * entities + entity) * tasks + task] == 0;
        for agent in (0..agents).filter(|agent| absent[frame * entities + agent] == 0) {
            let mut visible = EntityMask::EMPTY;
            for entity in 0..entities {
                let shared = (0..tasks).any(|task| member(agent, task) && member(entity, task));
                let seen = hidden[(frame * entities + agent) * entities + entity] == 0;
                if shared && seen && absent[frame * entities + entity] == 0 {
                    visible.insert(entity);
                }
            }
            let observation = OwnedObservation {
                rows: rows.chunks(columns).flat_map(|row| &row[..features]).copied().collect(),
                features,
                last_actions: rows.chunks(columns).take(agents).map(last).collect(),
                visible,
                self_index: agent,
                available: vec![1; actions],
            };
            let start = (frame * agents + agent) * actions;
            cases.push((observation, wanted[start..start + actions].to_vec()));
        }
    }
    cases
}

#[test]
fn the_recorded_network_gives_its_recorded_utilities() {
    let onnx = golden("onnx/agent_ff_default.onnx");
    let plan = AlignedBytes::copy_of(&compiled(&onnx).bytes);
    let plan = Plan::load(plan.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut plan = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let mut tract = GraphPolicy::by_tract(&onnx, 58).unwrap();
    let cases = recorded();
    assert_eq!(cases.len(), 14);
    for (index, (observation, want)) in cases.iter().enumerate() {
        for (name, policy) in [("plan", &mut plan as &mut dyn Policy), ("tract", &mut tract)] {
            let mut got = [0.0; 12];
            policy.utilities(&observation.view(), &mut got).unwrap();
            for (got, want) in got.iter().zip(want) {
                let error = (f64::from(*got) - want).abs() / (1.0 + want.abs());
                assert!(error < 1e-6, "{name}, case {index}: {got}, want {want}");
            }
        }
    }
}

#[test]
fn reports_what_the_plan_needs_and_how_exact_it_is() {
    let compiled = compiled(&golden("onnx/agent_ff_default.onnx"));
    let report = &compiled.report;
    let names: Vec<&str> = report.operators.iter().map(|op| op.name.as_str()).collect();
    assert_eq!(names, ["EmbedEntities", "AttendOwn", "Dense", "Dense", "MaskedArgmax"]);
    let max_distance = report.max_distance;
    assert!(max_distance > 0.1 && max_distance <= 16.0, "{report:?}");
    assert_eq!((report.inputs, report.action_mismatches), (256, 0));
    assert_eq!(report.flash_bytes, compiled.bytes.len());
    let facts = inspect_plan(&compiled.bytes).unwrap();
    assert_eq!((facts.n_max, facts.features, facts.actions), (11, 58, 12));
    assert_eq!((facts.macs, facts.arena_bytes), (report.macs, report.arena_bytes));
    assert_eq!(facts.proof, Proof::Distance { max_distance, inputs: 256 });
    assert_eq!(facts.operators, report.operators);
}

#[test]
fn fused_plans_run_where_the_processor_fuses_and_are_refused_elsewhere() {
    let onnx = golden("onnx/agent_ff_default.onnx");
    let options =
        CompileOptions { n_max: 11, profile: Profile::Fused, ..CompileOptions::default() };
    let fused = compile(&onnx, &options);
    if !Build::widest().fuses() {
        let refused = matches!(fused, Err(CompileError::Plan(PlanError::WrongProfile { got: 1 })));
        assert!(refused, "{fused:?}");
        return;
    }
    let fused = fused.unwrap();
    assert!(fused.report.max_distance <= 16.0, "{:?}", fused.report);
    let (facts, exact) = (inspect_plan(&fused.bytes).unwrap(), compiled(&onnx));
    assert_eq!(facts.profile, "fused");
    assert_eq!(inspect_plan(&exact.bytes).unwrap().profile, "exact");
    assert_eq!(facts.arena_bytes_per_agent, fused.report.arena_bytes_per_agent);
    assert!(facts.arena_bytes_per_agent > 0 && facts.arena_bytes_per_agent < facts.arena_bytes);
}

#[test]
fn the_same_file_gives_the_same_plan() {
    let onnx = golden("onnx/agent_small.onnx");
    assert_eq!(compiled(&onnx).bytes, compiled(&onnx).bytes);
}

#[test]
fn other_seeds_of_observations_agree_too() {
    for (file, features, actions) in [("agent_small", 6, 4), ("agent_ff_default", 58, 12)] {
        let onnx = golden(&format!("onnx/{file}.onnx"));
        let plan = compiled(&onnx).bytes;
        let observations = random_observations(100, 11, features, actions, 99);
        let comparison = beside_truth(&plan, &onnx, observations);
        assert!(comparison.agrees() && comparison.max_rel_error < 1e-6, "{file}: {comparison:?}");
        assert_eq!((comparison.inputs, comparison.action_mismatches), (100, 0));
    }
}

#[test]
fn metadata_tells_features_and_contract() {
    let onnx = golden("onnx/agent_small.onnx");
    let facts = inspect_onnx(&onnx).unwrap();
    assert_eq!((facts.ir_version, facts.opset), (8, 17));
    assert_eq!(facts.inputs[0], ("entities".to_owned(), "f32 [N, 10]".to_owned()));
    assert_eq!(facts.operators["MatMul"], 9);
    let plan = inspect_plan(&compiled(&onnx).bytes).unwrap();
    assert_eq!(plan.contract, "0123456789abcdef");
    assert_eq!(plan.features, 6);
    let options = CompileOptions { contract: Some(7), ..CompileOptions::default() };
    let plan = inspect_plan(&compile(&onnx, &options).unwrap().bytes).unwrap();
    assert_eq!(plan.contract, "0000000000000007");
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    let onnx = golden("onnx/agent_small.onnx");
    let refused = |options: CompileOptions| compile(&onnx, &options).map(|_| ()).unwrap_err();
    let error = refused(CompileOptions { features: Some(8), ..CompileOptions::default() });
    assert!(matches!(error, CompileError::Size { got: 10, want: 12, .. }), "{error}");
    let error = refused(CompileOptions { n_max: 129, ..CompileOptions::default() });
    assert!(matches!(error, CompileError::TooLarge { got: 129, max: 128, .. }), "{error}");
}

#[test]
fn damaged_files_are_errors_never_panics() {
    let onnx = golden("onnx/agent_small.onnx");
    for len in (0..onnx.len()).step_by(97) {
        assert!(compile(&onnx[..len], &CompileOptions::default()).is_err(), "cut at {len}");
    }
    for at in (0..onnx.len()).step_by(61) {
        let mut damaged = onnx.clone();
        damaged[at] ^= 0x55;
        // A changed weight compiles; whatever happens, it is an answer.
        let _ = compile(&damaged, &CompileOptions { inputs: 8, ..CompileOptions::default() });
    }
    let error = compile(b"not a model", &CompileOptions::default()).unwrap_err();
    assert!(error.to_string().starts_with("the ONNX file cannot be read"), "{error}");
}

#[test]
fn heads_and_widths_of_all_kinds_compile() {
    for file in ["agent_one_head", "agent_eight_heads", "agent_odd_sizes"] {
        let report = compiled(&golden(&format!("onnx/{file}.onnx"))).report;
        assert!(report.max_distance < 6.0, "{file}: {report:?}");
        assert_eq!(report.action_mismatches, 0, "{file}");
    }
}

#[test]
fn names_of_nodes_mean_nothing() {
    let onnx = golden("onnx/agent_small.onnx");
    let mut renamed = onnx.clone();
    for word in ["attention", "fc1", "fc2", "head", "visible", "entities", "self_index"] {
        let places = 0..renamed.len() - word.len();
        for at in places {
            if renamed[at..].starts_with(word.as_bytes()) {
                renamed[at] = b'Z';
            }
        }
    }
    let weights = |onnx: &[u8]| {
        let plan = compiled(onnx).bytes;
        plan[sortie_core::plan::HEADER_BYTES..].to_vec()
    };
    assert!(renamed != onnx);
    assert!(weights(&renamed) == weights(&onnx));
}

#[test]
fn what_does_not_match_is_named() {
    let error = compile(&golden("onnx/agent_scalar.onnx"), &CompileOptions::default());
    let Err(CompileError::Unsupported { node, operator, shapes, hint }) = error else {
        panic!("{error:?}");
    };
    assert_eq!((node.as_str(), operator.as_str()), ("head.product", "EinSum"));
    assert_eq!(shapes, "f32 [], f32 [1, 1]");
    assert!(hint.contains("constant matrix"));
}
