//! A bundle's agent is compiled once, kept beside it, and gives the golden answers.

use std::cell::Cell;
use std::fs;
use std::path::PathBuf;

use sortie_bundle::{
    AGENT, Bundle, ContractV1, Draft, Environment, FallbackAllocation, Golden, GoldenCase, Limits,
    MIN_CASES, Network, PlanKey, SubtaskConditioning, WIRE_ABI, cached_plan,
};
use sortie_compiler::{
    CompileError, CompileOptions, TractPolicy, compare_with_golden, compile, compile_bundle,
    random_observations,
};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{PlanPolicy, Policy};

fn onnx() -> Vec<u8> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/agent_small.onnx");
    fs::read(path).unwrap()
}

fn contract() -> ContractV1 {
    let names = |prefix: &str, count: usize| (0..count).map(|i| format!("{prefix}{i}")).collect();
    ContractV1 {
        abi: WIRE_ABI,
        actions: 4,
        features: 6,
        feature_names: names("f", 6),
        action_names: names("a", 4),
        decision_interval: 5,
        append_last_action: true,
        subtask_conditioning: SubtaskConditioning::Mask,
        subtask_actions: false,
        safe_action: Some(0),
        fallback_allocation: FallbackAllocation::Unallocated,
    }
}

/// A bundle whose golden answers are the graph's own.
fn bundle(home: &tempfile::TempDir, contract: ContractV1) -> Bundle {
    let mut policy = TractPolicy::new(&onnx(), 6).unwrap();
    let answer = |observation: sortie_bundle::OwnedObservation| {
        let mut utilities = vec![0.0; 4];
        policy.utilities(&observation.view(), &mut utilities).unwrap();
        let action = policy.decide(&observation.view()).unwrap().action;
        GoldenCase { observation, utilities, action }
    };
    let observations = random_observations(MIN_CASES, 8, 6, 4, 5);
    let draft = Draft {
        contract,
        environment: Environment::default(),
        limits: Limits { n_max: 8, t_max: 3, team_max: 2 },
        network: Network { agent: "masked-attention".into(), allocator: None, hidden: 0 },
        golden: Golden {
            cases: observations.into_iter().map(answer).collect(),
            allocations: Vec::new(),
        },
        parts: [(AGENT.to_owned(), onnx())].into(),
    };
    draft.write(&home.path().join("bundle")).unwrap()
}

#[test]
fn plan_and_graph_give_the_golden_answers() {
    let home = tempfile::tempdir().unwrap();
    let bundle = bundle(&home, contract());
    let bytes = compile_bundle(&bundle).unwrap();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    assert_eq!((plan.header().n_max, plan.header().t_max), (8, 3));
    assert_eq!(plan.header().contract, bundle.contract().hash());
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut plan = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let mut tract = TractPolicy::new(bundle.agent_onnx(), 6).unwrap();
    for (name, policy) in [("plan", &mut plan as &mut dyn Policy), ("tract", &mut tract)] {
        let comparison = compare_with_golden(name, policy, bundle.golden()).unwrap();
        assert!(comparison.max_rel_error < 1e-6, "{comparison:?}");
        assert_eq!((comparison.inputs, comparison.action_mismatches), (MIN_CASES, 0));
    }
}

#[test]
fn a_bundle_stays_valid_with_plans_beside_it() {
    let home = tempfile::tempdir().unwrap();
    let bundle = bundle(&home, contract());
    let first = compile_bundle(&bundle).unwrap();
    assert_eq!(fs::read_dir(bundle.folder().join("plans")).unwrap().count(), 1);
    assert_eq!(Bundle::open(bundle.folder()).unwrap().id(), bundle.id());
    assert_eq!(first.as_slice(), compile_bundle(&bundle).unwrap().as_slice());
}

#[test]
fn a_network_of_other_sizes_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let mut wrong = contract();
    wrong.features = 5;
    wrong.feature_names.pop();
    let golden = TractPolicy::new(&onnx(), 5).map(|_| ());
    assert!(matches!(golden, Err(CompileError::Size { got: 10, want: 9, .. })));
    let good = bundle(&home, contract());
    let options = CompileOptions { features: Some(5), ..CompileOptions::default() };
    let error = compile(good.agent_onnx(), &options).unwrap_err();
    assert_eq!(error.to_string(), "the input width is 10 in the file, the contract says 9");
}

/// Asks for the small network's plan and says whether it had to be compiled.
fn compiled_anew(places: &[PathBuf], onnx: &[u8], version: &str) -> bool {
    let key = PlanKey { onnx, profile: "exact", compiler: version, contract: 1, n_max: 8 };
    let compiled = Cell::new(false);
    let plan = cached_plan(places, &key, || {
        compiled.set(true);
        compile(onnx, &CompileOptions::default()).map(|compiled| compiled.bytes)
    });
    assert!(Plan::load(plan.unwrap().as_slice()).is_ok());
    compiled.get()
}

#[test]
fn a_plan_is_compiled_once_and_again_when_damaged_or_old() {
    let home = tempfile::tempdir().unwrap();
    let places = [home.path().join("plans")];
    let onnx = onnx();
    assert!(compiled_anew(&places, &onnx, "1"));
    assert!(!compiled_anew(&places, &onnx, "1"));
    assert!(compiled_anew(&places, &onnx, "2"), "another compiler");
    for file in fs::read_dir(&places[0]).unwrap() {
        let path = file.unwrap().path();
        let mut bytes = fs::read(&path).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        fs::write(&path, bytes).unwrap();
    }
    assert!(compiled_anew(&places, &onnx, "1"), "damaged");
    assert!(!compiled_anew(&places, &onnx, "1"), "replaced");
}

#[test]
fn the_second_place_serves_where_the_first_cannot_be_written() {
    let home = tempfile::tempdir().unwrap();
    let blocked = home.path().join("file");
    fs::write(&blocked, "not a folder").unwrap();
    let places = [blocked.join("plans"), home.path().join("cache")];
    assert!(compiled_anew(&places, &onnx(), "1"));
    assert!(!compiled_anew(&places, &onnx(), "1"));
    let nowhere = [blocked.join("plans")];
    assert!(compiled_anew(&nowhere, &onnx(), "1"));
    assert!(compiled_anew(&nowhere, &onnx(), "1"));
}
