//! Trunk, step and critic become a plan that proposes and values allocations as the graphs do.

use std::sync::OnceLock;

use sortie_bundle::OwnedAllocationState;
use sortie_compiler::{compare_with_files, compile, compile_proposals};
use sortie_core::allocate::ProposalAllocator;
use sortie_core::allocate::proposals::{Draw, GumbelDraw};
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Network, Plan, PlanError, Profile};
use sortie_core::{AllocateError, Allocator, EntityMask, UNASSIGNED};
use sortie_plans::{
    CompileError, CompileOptions, NetworkFiles, NetworkInput, ProposalFiles, inspect_plan,
    random_allocation_states,
};

const N_MAX: usize = 9;
const FEATURES: usize = 7;
const TASKS: usize = 3;

fn golden(name: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    std::fs::read(format!("{root}proposals_{name}_small.onnx")).unwrap()
}

fn with_files<T>(work: impl FnOnce(&ProposalFiles<'_>) -> T) -> T {
    let [trunk, step, critic] = ["trunk", "step", "critic"].map(golden);
    work(&ProposalFiles { trunk: &trunk, step: &step, critic: &critic })
}

fn plan_as(profile: Profile) -> AlignedBytes {
    let options = CompileOptions { n_max: N_MAX, profile, ..CompileOptions::default() };
    let compiled = with_files(|files| compile_proposals(files, &options)).unwrap();
    AlignedBytes::copy_of(&compiled.bytes)
}

/// The plan of the default profile, compiled once for all tests.
fn plan() -> &'static AlignedBytes {
    static PLAN: OnceLock<AlignedBytes> = OnceLock::new();
    PLAN.get_or_init(|| plan_as(Profile::Exact))
}

/// Asks an allocator of the plan; the memory is not clean.
fn ask<T>(
    plan: &AlignedBytes,
    proposals: usize,
    work: impl FnOnce(&mut ProposalAllocator<'_>) -> T,
) -> T {
    let plan = Plan::load(plan.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&plan, proposals));
    arena.as_mut_slice().fill(0xff);
    let mut allocator = ProposalAllocator::new(plan, arena.as_mut_slice(), proposals, 5).unwrap();
    work(&mut allocator)
}

fn allocate(
    plan: &AlignedBytes,
    proposals: usize,
    state: &OwnedAllocationState,
) -> Result<Vec<u8>, AllocateError> {
    let mut allocation = vec![77; state.agents];
    let view = state.view();
    ask(plan, proposals, |allocator| allocator.allocate(&view, &mut allocation))
        .map(|()| allocation)
}

fn states(count: usize) -> Vec<OwnedAllocationState> {
    random_allocation_states(count, N_MAX, FEATURES, TASKS, 3)
}

/// A state in which three agents and three subtasks with an entity each exist.
fn full() -> OwnedAllocationState {
    OwnedAllocationState {
        agents: 3,
        tasks: TASKS,
        rows: (0..6 * FEATURES).map(|index| (index * 37 % 19) as f32 / 9.0 - 1.0).collect(),
        features: FEATURES,
        present: EntityMask::first(6),
        entity_task: vec![0, 0b10, 0b100, 1, 0b10, 0b100],
        open_tasks: 0b111,
        available: Vec::new(),
    }
}

#[test]
fn the_plan_agrees_with_the_graphs() {
    for profile in [Profile::Exact, Profile::Fused] {
        let plan = plan_as(profile);
        let facts = inspect_plan(plan.as_slice()).unwrap();
        assert_eq!((facts.network, facts.features, facts.t_max), (Network::Proposals, FEATURES, 3));
        let compare = |files: &ProposalFiles<'_>| {
            let inputs = states(60).into_iter().map(NetworkInput::from).collect();
            let files = NetworkFiles::Proposals(*files);
            compare_with_files(plan.as_slice(), &files, inputs, 1).unwrap()
        };
        let comparison = with_files(compare);
        assert!(comparison.agrees() && comparison.inputs == 60, "{comparison:?}");
        assert!(comparison.refused < 40, "{comparison:?}");
    }
}

#[test]
fn parts_in_the_wrong_place_are_refused() {
    let error = with_files(|files| compile(files.step, &CompileOptions::default())).unwrap_err();
    assert!(matches!(error, CompileError::PartAlone { .. }), "{error}");
    let swapped = with_files(|files| {
        let swapped = ProposalFiles { trunk: files.critic, critic: files.trunk, ..*files };
        compile_proposals(&swapped, &CompileOptions::default())
    });
    let error = swapped.unwrap_err();
    assert!(error.to_string().contains("trunk"), "{error}");
    let options = CompileOptions { profile: Profile::Int8, ..CompileOptions::default() };
    let error = with_files(|files| compile_proposals(files, &options)).unwrap_err();
    assert!(matches!(error, CompileError::NoInt8 { .. }), "{error}");
}

#[test]
fn every_allocation_is_feasible_and_the_same_on_every_call_and_build() {
    let plan = plan();
    let mut assigned = 0;
    for state in states(300) {
        let allocation = allocate(plan, 8, &state).unwrap();
        assert_eq!(allocation, allocate(plan, 8, &state).unwrap());
        let view = state.view();
        let values = |build: Build| {
            let loaded = Plan::load(plan.as_slice()).unwrap().on(build);
            let mut arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&loaded, 8));
            let arena = arena.as_mut_slice();
            let mut allocator = ProposalAllocator::new(loaded, arena, 8, 5).unwrap();
            let proposals = allocator.propose(&view, &mut GumbelDraw { seed: 9 }).unwrap();
            proposals.values().iter().map(|value| value.to_bits()).collect::<Vec<_>>()
        };
        assert!(Build::all().all(|build| values(build) == values(Build::PORTABLE)));
        for (agent, task) in allocation.into_iter().enumerate() {
            let placed = task != UNASSIGNED;
            assert_eq!(placed, state.present.contains(agent) && state.open_tasks != 0);
            assert!(!placed || state.open_tasks >> task & 1 == 1, "{state:?}");
            assigned += usize::from(placed);
        }
    }
    assert!(assigned > 200, "{assigned}");
}

#[test]
fn nobody_and_nothing_open_leave_everybody_unassigned() {
    let plan = plan();
    let nobody = OwnedAllocationState { present: EntityMask::EMPTY, ..full() };
    assert_eq!(allocate(plan, 4, &nobody), Ok(vec![UNASSIGNED; 3]));
    let closed = OwnedAllocationState { open_tasks: 0, ..full() };
    assert_eq!(allocate(plan, 4, &closed), Ok(vec![UNASSIGNED; 3]));
}

#[test]
fn what_cannot_be_looked_at_is_refused_by_name() {
    let plan = plan();
    let with = |change: fn(&mut OwnedAllocationState)| {
        let mut state = full();
        change(&mut state);
        allocate(plan, 4, &state)
    };
    assert!(with(|_| {}).is_ok());
    for bad in [f32::NAN, f32::INFINITY] {
        let mut state = full();
        state.rows[4 * FEATURES] = bad;
        assert_eq!(allocate(plan, 4, &state), Err(AllocateError::NonFinite));
        state.present.remove(4);
        assert!(allocate(plan, 4, &state).is_ok(), "what is absent does not matter");
    }
    assert_eq!(with(|state| state.rows[0] = 3.0e38), Err(AllocateError::NonFinite));
    assert_eq!(with(|state| state.rows.truncate(41)), Err(AllocateError::BadLength));
    assert_eq!(with(|state| state.open_tasks = 0b1000), Err(AllocateError::BadLength));
    assert_eq!(with(|state| state.tasks = 4), Err(AllocateError::TooLarge));
    let eleven = |state: &mut OwnedAllocationState| {
        state.entity_task.resize(11, 0);
        state.rows.resize(11 * FEATURES, 0.0);
    };
    assert_eq!(with(eleven), Err(AllocateError::TooLarge));
}

/// Takes the subtasks that the number of the proposal, written in base T, spells.
struct Enumerated {
    log_pi: Vec<f64>,
}

impl Draw for Enumerated {
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], _: u32) -> usize {
        let task = proposal / TASKS.pow(agent as u32) % TASKS;
        let total: f64 = logits.iter().map(|logit| f64::from(*logit).exp()).sum();
        self.log_pi[proposal] += f64::from(logits[task]) - total.ln();
        task
    }
}

#[test]
fn the_probabilities_of_all_allocations_sum_to_one() {
    let plan = plan();
    let state = full();
    let mut draw = Enumerated { log_pi: vec![0.0; 27] };
    let values = ask(plan, 27, |allocator| {
        let proposals = allocator.propose(&state.view(), &mut draw).unwrap();
        proposals.values().to_vec()
    });
    let total: f64 = draw.log_pi.iter().map(|log_pi| log_pi.exp()).sum();
    assert!((total - 1.0).abs() < 1e-6, "{total}");
    // With this many proposals the best of all allocations is among them.
    let best = values.iter().cloned().fold(f32::MIN, f32::max);
    let chosen = allocate(plan, 256, &state).unwrap();
    let number = chosen.iter().rev().fold(0, |number, task| number * TASKS + usize::from(*task));
    assert_eq!(values[number], best);
}

/// Chooses what is closed.
struct Wrong(usize);

impl Draw for Wrong {
    fn draw(&mut self, _: usize, _: usize, _: &[f32], _: u32) -> usize {
        self.0
    }
}

#[test]
fn a_draw_that_is_not_open_is_refused() {
    let plan = plan();
    let state = OwnedAllocationState { open_tasks: 0b101, ..full() };
    for wrong in [1, 3, 31, 32, usize::MAX] {
        let refused =
            ask(plan, 2, |allocator| allocator.propose(&state.view(), &mut Wrong(wrong)).map(drop));
        assert_eq!(refused, Err(AllocateError::Infeasible));
    }
}

#[test]
fn an_arena_is_large_enough_or_refused() {
    let bytes = plan();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    assert_eq!(ProposalAllocator::arena_bytes(&plan, 32), plan.arena_bytes());
    for proposals in [1, 2, 256] {
        let need = ProposalAllocator::arena_bytes(&plan, proposals);
        let mut arena = AlignedBytes::zeroed(need - 1);
        let refused = ProposalAllocator::new(plan.clone(), arena.as_mut_slice(), proposals, 0);
        assert_eq!(refused.unwrap_err(), PlanError::ArenaTooSmall { need, got: need - 1 });
    }
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes() + 64);
    let refused = ProposalAllocator::new(plan, &mut arena.as_mut_slice()[4..], 32, 0);
    assert_eq!(refused.unwrap_err(), PlanError::Misaligned { need: 64, got: 4 });
}

#[test]
fn one_proposal_is_the_greedy_allocation() {
    /// The most probable subtask.
    struct Greedy;
    impl Draw for Greedy {
        fn draw(&mut self, _: usize, _: usize, logits: &[f32], open_tasks: u32) -> usize {
            sortie_core::allocate::proposals::largest_open(logits, open_tasks)
        }
    }
    let plan = plan();
    for state in states(100) {
        let greedy: Vec<u8> = ask(plan, 1, |allocator| {
            let proposals = allocator.propose(&state.view(), &mut Greedy).unwrap();
            proposals.allocation(0).collect()
        });
        assert_eq!(allocate(plan, 1, &state).unwrap(), greedy);
    }
}
