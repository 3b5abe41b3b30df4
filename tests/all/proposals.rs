//! A bundle whose allocator proposes: verified, evaluated and run.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::Deserialize;
use sortie_bundle::{AGENT, Bundle, Draft, GoldenAllocation, MIN_CASES, PROPOSAL_PARTS, PROPOSALS};
use sortie_core::allocate::ProposalAllocator;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{Allocator, UNASSIGNED};
use sortie_envs::random::generator;
use sortie_methods::proposals::{
    AllocationCritic, AllocationPolicy, AllocationShape, Parameters, export_proposals, transpose,
};
use sortie_plans::{BundlePlans, CompilerProcess};

use crate::support::{BUNDLE, json};

/// The shipped team with an allocator of random weights, which proposes.
fn proposing(folder: &Path) {
    let team = Bundle::open(Path::new(BUNDLE)).expect("the shipped bundle");
    let (contract, limits) = (team.contract().clone(), team.manifest().limits);
    let shape = AllocationShape {
        features: contract.features.into(),
        columns: limits.t_max.into(),
        width: 16,
        heads: 2,
    };
    let (policy, critic) = networks(shape);
    let graphs = export_proposals(&policy, &critic, contract.hash()).expect("finite weights");
    let parts = [graphs.trunk, graphs.step, graphs.critic];
    let mut parts: BTreeMap<String, Vec<u8>> =
        PROPOSAL_PARTS.iter().map(|name| (*name).to_owned()).zip(parts).collect();
    parts.insert(AGENT.to_owned(), team.agent_onnx().to_vec());
    let mut network = team.manifest().network.clone();
    network.allocator = Some(PROPOSALS.to_owned());
    let environment = team.manifest().contract.environment.clone();
    let mut golden = team.golden().clone();
    golden.allocations.clear();
    golden.cases.truncate(MIN_CASES);
    let draft = Draft { contract, environment, limits, network, golden, parts };
    draft.write(folder).expect("a new folder");
}

/// Tensors of both networks, as they are drawn.
const ENTITIES: [&str; 3] = ["entity.weight", "entity.bias", "task.weight"];
const ATTENTION: [&str; 3] = ["attention.in.weight", "attention.out.weight", "attention.out.bias"];
const COUNTS: [&str; 2] = ["count.weight", "count.bias"];

/// Fills parameters with such numbers, which are in the layouts of PyTorch.
fn fill(
    parameters: &mut Parameters,
    names: &[&str],
    width: usize,
    mut tensor: impl FnMut(usize) -> Vec<f32>,
) {
    for name in names {
        let own = parameters.tensors().iter().find(|tensor| tensor.name == *name);
        let range = own.expect(name).range.clone();
        let drawn = tensor(range.len());
        let is_turned = ["entity.weight", "task.weight", "count.weight"].contains(name);
        let drawn = if is_turned { transpose(&drawn, width, drawn.len() / width) } else { drawn };
        parameters.values[range].copy_from_slice(&drawn);
    }
}

fn networks(shape: AllocationShape) -> (AllocationPolicy, AllocationCritic) {
    let width = shape.width;
    let mut state = 11_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / 8_388_608.0 - 1.0) * 0.25
    };
    let mut tensor = |count: usize| (0..count).map(|_| next()).collect::<Vec<f32>>();
    let random = &mut generator(1);
    let mut policy = AllocationPolicy::initialise(shape, random);
    for part in [&ENTITIES[..], &ATTENTION, &COUNTS] {
        fill(&mut policy.parameters, part, width, &mut tensor);
    }
    // Of every row of the update, the task's half stands before the agent's.
    let update = tensor(2 * width * width);
    for (half, name) in ["update.task.weight", "update.agent.weight"].iter().enumerate() {
        let rows = update.chunks(width).skip(half).step_by(2);
        let half = |_| rows.clone().flatten().copied().collect();
        fill(&mut policy.parameters, &[name], width, half);
    }
    fill(&mut policy.parameters, &["update.agent.bias"], width, &mut tensor);
    let mut critic = AllocationCritic::initialise(shape, random);
    for part in [&ENTITIES[..], &COUNTS, &ATTENTION] {
        fill(&mut critic.parameters, part, width, &mut tensor);
    }
    fill(&mut critic.parameters, &["value.weight", "value.bias"], width, &mut tensor);
    (policy, critic)
}

/// The team of [`proposing`] but for its agents, who are those of the shipped team, and what it allocates: for tests of
/// the Python package, which can make no bundle.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/proposing-team");

/// Allocations in the states that the shipped team recorded.
#[derive(Deserialize)]
struct Recorded {
    proposals: usize,
    seed: u64,
    /// -1: none.
    allocations: Vec<Vec<i64>>,
}

/// What the team's allocator gives in the states that the shipped team recorded, by so many proposals from a seed.
fn allocations(bundle: &Bundle, proposals: usize, seed: u64) -> Vec<Vec<i64>> {
    let compiler = Path::new(env!("CARGO_BIN_EXE_sortie")).with_file_name("sortie-tools");
    let plans = BundlePlans::new(CompilerProcess::new(compiler, ["compiler"]), None, |_| {});
    let plan = plans.proposals(bundle, Profile::Exact).expect("a plan").expect("it proposes");
    let plan = Plan::load(plan.as_slice()).expect("a plan");
    let mut arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&plan, proposals));
    let allocator = ProposalAllocator::new(plan, arena.as_mut_slice(), proposals, seed);
    let mut allocator = allocator.expect("an allocator");
    let shipped = Bundle::open(Path::new(BUNDLE)).expect("the shipped bundle");
    let answer = |case: &GoldenAllocation| {
        let mut allocation = vec![0; case.state.agents];
        allocator.allocate(&case.state.view(), &mut allocation).expect("an allocation");
        let number = |task| if task == UNASSIGNED { -1 } else { i64::from(task) };
        allocation.into_iter().map(number).collect()
    };
    shipped.golden().allocations.iter().map(answer).collect()
}

#[test]
fn the_recorded_team_is_this_one_and_its_allocations_are_recorded() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let folder = place.path().join("proposing");
    proposing(&folder);
    let bundle = Bundle::open(&folder).expect("a bundle");
    let recorded = Path::new(RECORDED);
    for file in PROPOSAL_PARTS.into_iter().chain(["bundle.toml", "golden.json"]) {
        let (made, kept) = (folder.join(file), recorded.join(file));
        assert!(fs::read(made).unwrap() == fs::read(kept).unwrap(), "{file}");
    }
    let text = fs::read_to_string(recorded.join("allocations.json")).expect("the recorded file");
    let recorded: Vec<Recorded> = serde_json::from_str(&text).expect("recorded allocations");
    assert!(recorded.len() > 2);
    for Recorded { proposals, seed, allocations: wanted } in recorded {
        assert_eq!(allocations(&bundle, proposals, seed), wanted, "{proposals} from {seed}");
    }
}

#[test]
fn a_bundle_that_proposes_is_verified_evaluated_and_run() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let folder = place.path().join("proposing");
    proposing(&folder);
    let bundle = folder.display().to_string();
    let verified = json(&["verify", &bundle, "--inputs", "32", "--against", "tract", "--json"]);
    let engines = verified["engines"].as_array().expect("engines");
    for engine in ["tract", "double precision"] {
        let name = format!("allocator plan against {engine}");
        assert!(engines.iter().any(|engine| engine["name"] == name.as_str()), "{verified}");
    }

    let eval = |proposals: &str| {
        let arguments = ["eval", &bundle, "--episodes", "4", "--proposals", proposals, "--json"];
        json(&arguments)
    };
    let (several, greedy) = (eval("8"), eval("1"));
    assert_eq!(several, eval("8"), "the same seed allocates the same");
    assert_ne!(several["return_mean"], greedy["return_mean"], "proposals matter");

    let run = ["run", &bundle, "--episodes", "2", "--in-process", "--proposals", "4", "--json"];
    let run = json(&run);
    assert_eq!(run["episodes"], 2, "{run}");
}
