//! Which plan of a bundle acts: the one that it ships, one that was compiled before, a new one; and only if it gives
//! the golden answers.

use std::cell::Cell;
use std::fs;
use std::path::PathBuf;

use sortie_bundle::{
    AGENT, Bundle, CONTRACT_ABI, ContractV1, Draft, Environment, FallbackAllocation, Golden,
    GoldenCase, Limits, MIN_CASES, Network, Recording, SubtaskConditioning,
};
use sortie_compiler::{GraphPolicy, InProcess, compile};
use sortie_core::plan::{AlignedBytes, Header, Plan, Profile, checksums};
use sortie_core::{PlanPolicy, Policy};
use sortie_plans::{
    BundlePlans, CompileError, CompileOptions, Compiled, CompiledPolicy, Compiler, PolicyOptions,
    ProposalFiles, compare_with_golden, quantise, random_observations,
};

fn onnx() -> Vec<u8> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/agent_small.onnx");
    fs::read(path).unwrap()
}

fn contract() -> ContractV1 {
    let names = |prefix: &str, count: usize| (0..count).map(|i| format!("{prefix}{i}")).collect();
    ContractV1 {
        abi: CONTRACT_ABI,
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

/// What compiles, and how often it did.
#[derive(Default)]
struct Counting(Cell<usize>);

impl Compiler for &Counting {
    fn compile(&self, onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError> {
        self.0.set(self.0.get() + 1);
        InProcess.compile(onnx, options)
    }

    fn compile_rounded(
        &self,
        onnx: &[u8],
        options: &CompileOptions,
        examples: &Recording,
    ) -> Result<Compiled, CompileError> {
        self.0.set(self.0.get() + 1);
        InProcess.compile_rounded(onnx, options, examples)
    }

    fn compile_proposals(
        &self,
        files: &ProposalFiles<'_>,
        options: &CompileOptions,
    ) -> Result<Compiled, CompileError> {
        InProcess.compile_proposals(files, options)
    }

    fn compile_policy(
        &self,
        onnx: &[u8],
        policy: &PolicyOptions,
        options: &CompileOptions,
    ) -> Result<CompiledPolicy, CompileError> {
        self.0.set(self.0.get() + 1);
        InProcess.compile_policy(onnx, policy, options)
    }
}

fn plans(cache: Option<PathBuf>) -> BundlePlans<InProcess> {
    BundlePlans::new(InProcess, cache, |note| panic!("{note}"))
}

/// A bundle whose golden answers are the graph's own.
fn bundle(home: &tempfile::TempDir, contract: ContractV1) -> Bundle {
    let mut policy = GraphPolicy::by_tract(&onnx(), 6).unwrap();
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
        network: Network { agent: "masked-attention".into(), ..Network::default() },
        golden: Golden {
            cases: observations.into_iter().map(answer).collect(),
            ..Golden::default()
        },
        parts: [(AGENT.to_owned(), onnx())].into(),
    };
    draft.write(&home.path().join("bundle")).unwrap()
}

#[test]
fn plan_and_graph_give_the_golden_answers() {
    let home = tempfile::tempdir().unwrap();
    let bundle = bundle(&home, contract());
    let plans = plans(None).agents(&bundle, Profile::Exact).unwrap();
    let [bytes] = plans.plans() else { panic!("one graph, one plan") };
    let plan = Plan::load(bytes.as_slice()).unwrap();
    assert_eq!((plan.header().n_max, plan.header().t_max), (8, 3));
    assert_eq!(plan.header().contract, bundle.contract().hash());
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut plan = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let mut tract = GraphPolicy::by_tract(bundle.agent_onnx(), 6).unwrap();
    for (name, policy) in [("plan", &mut plan as &mut dyn Policy), ("tract", &mut tract)] {
        let comparison = compare_with_golden(policy, &bundle.golden().cases, &[]);
        assert!(comparison.max_rel_error < 1e-6, "{name}: {comparison:?}");
        assert_eq!((comparison.inputs, comparison.action_mismatches), (MIN_CASES, 0));
    }
}

#[test]
fn a_network_of_other_sizes_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let mut wrong = contract();
    wrong.features = 5;
    wrong.feature_names.pop();
    let golden = GraphPolicy::by_tract(&onnx(), 5).map(|_| ());
    assert!(matches!(golden, Err(CompileError::Size { got: 10, want: 9, .. })));
    let good = bundle(&home, contract());
    let options = CompileOptions { features: Some(5), ..CompileOptions::default() };
    let error = compile(good.agent_onnx(), &options).unwrap_err();
    assert_eq!(error.to_string(), "the input width is 10 in the file, the contract says 9");
}

#[test]
fn an_int8_plan_is_rounded_for_the_golden_observations() {
    let home = tempfile::tempdir().unwrap();
    let (bundle, plans) = (bundle(&home, contract()), plans(None));
    let found = plans.agents(&bundle, Profile::Int8).unwrap();
    let compiled = |profile, observations| {
        let examples = bundle.golden_recording(observations);
        plans.agent(&bundle, profile, &examples).unwrap().bytes
    };
    let all = compiled(Profile::Int8, usize::MAX);
    assert_eq!(found.plans()[0].as_slice(), all);
    assert_ne!(all, compiled(Profile::Int8, 8));
    // In other profiles nothing is rounded.
    assert_eq!(compiled(Profile::Exact, usize::MAX), compiled(Profile::Exact, 8));
}

#[test]
fn observations_that_judge_an_int8_plan_rounded_nothing() {
    let home = tempfile::tempdir().unwrap();
    let bundle = bundle(&home, contract());
    let recording = bundle.golden_recording(usize::MAX);
    let [examples, judges] = recording.split(10);
    let compile = |profile, given: &Recording| {
        assert_eq!(*given, examples);
        plans(None).agent(&bundle, profile, given)
    };
    let quantised = quantise(compile, &recording).unwrap();
    assert_eq!(quantised.agreement.observations, judges.observations().count());
    assert!(quantised.agreement.share() > 0.9, "{:?}", quantised.agreement);
}

/// The bundle with plans of its own, in another folder.
fn shipping(home: &tempfile::TempDir, change: fn(&mut Vec<u8>)) -> Bundle {
    let bundle = bundle(home, contract());
    let mut draft = bundle.draft();
    for (name, mut plan) in plans(None).shipped(&bundle).unwrap() {
        change(&mut plan);
        draft.parts.insert(name, plan);
    }
    draft.write(&home.path().join("shipping")).unwrap()
}

/// Asks for the agent's plan and says how often something was compiled, and what was noted.
fn asked(bundle: &Bundle, cache: Option<PathBuf>) -> (Result<(), CompileError>, usize, bool) {
    thread_local!(static NOTED: Cell<bool> = const { Cell::new(false) });
    NOTED.set(false);
    let compiler = Counting::default();
    let plans = BundlePlans::new(&compiler, cache, |_| NOTED.set(true));
    let found = plans.agents(bundle, Profile::Exact).map(|_| ());
    (found, compiler.0.get(), NOTED.get())
}

/// Changes header and weights of a plan, and makes both checksums fit again.
fn forge(plan: &mut [u8], change: impl FnOnce(&mut Header, &mut [u8])) {
    let (mut header, _) = Header::read(plan).unwrap();
    let place = |offset: u32, len: u32| offset as usize..(offset + len) as usize;
    let program = place(header.program_offset, header.program_len);
    let weights = place(header.weights_offset, header.weights_len);
    change(&mut header, &mut plan[weights.clone()]);
    let bytes = header.to_bytes(checksums(&header, &plan[program], &plan[weights]));
    plan[..bytes.len()].copy_from_slice(&bytes);
}

fn other_source(header: &mut Header, _: &mut [u8]) {
    header.source[0] ^= 1;
}

fn negate(_: &mut Header, weights: &mut [u8]) {
    weights.chunks_exact_mut(4).for_each(|weight| weight[3] ^= 0x80);
}

#[test]
fn a_shipped_plan_acts_without_being_compiled() {
    let home = tempfile::tempdir().unwrap();
    let bundle = shipping(&home, |_| {});
    let (found, compiled, noted) = asked(&bundle, None);
    assert!(found.is_ok() && compiled == 0 && !noted, "{found:?}");
}

#[test]
fn a_shipped_plan_of_another_version_is_passed_over_with_a_note() {
    let home = tempfile::tempdir().unwrap();
    let bundle = shipping(&home, |plan| plan[8] = 99);
    let (found, compiled, noted) = asked(&bundle, None);
    assert!(found.is_ok() && compiled == 1 && noted, "{found:?}");
}

#[test]
fn a_shipped_plan_that_gives_other_answers_never_acts() {
    let home = tempfile::tempdir().unwrap();
    let bundle = shipping(&home, |plan| forge(plan, negate));
    let (found, ..) = asked(&bundle, None);
    assert!(matches!(found, Err(CompileError::Unproved { cases: MIN_CASES, .. })), "{found:?}");
}

#[test]
fn a_shipped_plan_of_another_network_is_refused() {
    let home = tempfile::tempdir().unwrap();

    let bundle = shipping(&home, |plan| forge(plan, other_source));
    let (found, ..) = asked(&bundle, None);
    assert!(matches!(found, Err(CompileError::ForeignPlan { .. })), "{found:?}");
}

#[test]
fn a_plan_is_compiled_once_and_again_when_damaged_or_forged() {
    let home = tempfile::tempdir().unwrap();
    let bundle = bundle(&home, contract());
    let cache = home.path().join("cache");
    let compiled = || {
        let (found, compiled, noted) = asked(&bundle, Some(cache.clone()));
        assert!(found.is_ok(), "{found:?}");
        (compiled, noted)
    };
    let kept = || fs::read_dir(&cache).unwrap().next().unwrap().unwrap().path();
    assert_eq!(compiled(), (1, false));
    assert_eq!(compiled(), (0, false));
    let mut damaged = fs::read(kept()).unwrap();
    *damaged.last_mut().unwrap() ^= 1;
    fs::write(kept(), damaged).unwrap();
    assert_eq!(compiled(), (1, false));
    assert_eq!(compiled(), (0, false));
    let mut forged = fs::read(kept()).unwrap();
    forge(&mut forged, negate);
    fs::write(kept(), forged).unwrap();
    assert_eq!(compiled(), (1, true));
    assert_eq!(compiled(), (0, false));
}

#[test]
fn a_cache_that_cannot_be_written_costs_time_only() {
    let home = tempfile::tempdir().unwrap();
    let bundle = bundle(&home, contract());
    let blocked = home.path().join("file");
    fs::write(&blocked, "not a folder").unwrap();
    for _ in 0..2 {
        let (found, compiled, _) = asked(&bundle, Some(blocked.join("plans")));
        assert!(found.is_ok() && compiled == 1, "{found:?}");
    }
}
