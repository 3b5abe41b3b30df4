//! Nothing after load touches the heap, shown by a counting allocator.
//!
//! `SORTIE_DECISIONS` sets the number of decisions (20,000); there is one allocation for every hundred.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use sortie_core::allocate::{
    CostAllocator, CostMethod, CostModel, LastAllocation, PlanTeamValue, PointingAllocator,
    PointingRules, ProposalAllocator, SearchMemory, TaskRelation, TeamValueAllocator, exact,
};
use sortie_core::options::{
    Affordance, Milestone, OptionPolicy, OptionRules, PictureShape, PlanNetworks, Pursuit,
};
use sortie_core::plan::{Aligned, Given, Plan, arena_bytes};
use sortie_core::{
    AllocateError, AllocationState, Allocator, EntityMask, NO_ACTION, Observation, PlanPolicy,
    Policy, include_plan,
};

const AGENT: &[u8] = include_plan!("../../../tests/golden/plans/agent-2.0.plan");
const INT8: &[u8] = include_plan!("../../../tests/golden/plans/agent-int8-2.2.plan");
const SKIP: &[u8] = include_plan!("../../../tests/golden/plans/agent-skip-2.0.plan");
const TEAM_VALUE: &[u8] = include_plan!("../../../tests/golden/plans/team-value-2.0.plan");

const POLICY: &[u8] = include_plan!("../../../tests/golden/plans/policy-2.0.plan");
const PROPOSALS: &[u8] = include_plan!("../../../tests/golden/plans/proposals-2.0.plan");
const ENCODER: &[u8] = include_plan!("../../../tests/golden/plans/pointing-encoder-2.3.plan");
const DECODER: &[u8] = include_plan!("../../../tests/golden/plans/pointing-decoder-2.3.plan");

const CONTROLLER: &[u8] = include_plan!("../../../models/crafting-iron/agent-controller.plan");
const META: &[u8] = include_plan!("../../../models/crafting-iron/agent-meta.plan");
const AFFORDANCE: &[u8] = include_plan!("../../../models/crafting-iron/agent-affordance.plan");

/// The system's allocator, counting the calls of each thread.
struct Counting;

thread_local! {
    static CALLS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    CALLS.set(CALLS.get() + 1);
}

// SAFETY: every call goes to the system's allocator as it came; counting touches no memory of the heap.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Heap calls of this thread while `work` runs.
fn heap_calls(work: impl FnOnce()) -> usize {
    let before = CALLS.get();
    work();
    CALLS.get() - before
}

fn decisions() -> usize {
    let wanted = std::env::var("SORTIE_DECISIONS").ok();
    wanted.map_or(20_000, |wanted| wanted.parse().expect("SORTIE_DECISIONS is a number"))
}

struct Constant(f32);

impl TaskRelation for Constant {
    fn columns(&self) -> usize {
        3
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, _: usize, relation: &mut [f32]) {
        relation.fill(self.0);
    }
}

impl CostModel for Constant {
    fn costs(&mut self, _: &AllocationState<'_>, costs: &mut [f32]) -> Result<(), AllocateError> {
        costs.fill(self.0);
        Ok(())
    }
}

#[test]
fn the_counter_counts() {
    assert_eq!(heap_calls(|| drop(std::hint::black_box(Box::new(1)))), 2);
}

#[test]
fn decisions_never_touch_the_heap() {
    decide::<{ arena_bytes(AGENT) }>(AGENT);
}

#[test]
fn int8_decisions_never_touch_the_heap() {
    decide::<{ arena_bytes(INT8) }>(INT8);
}

#[test]
fn decisions_with_a_skip_never_touch_the_heap() {
    decide::<{ arena_bytes(SKIP) }>(SKIP);
}

fn decide<const ARENA: usize>(plan: &[u8]) {
    let rows: Vec<f32> = (0..30).map(|number| (number % 7) as f32 / 6.0 - 0.5).collect();
    let mut arena = Aligned([0; ARENA]);
    let count = decisions();
    let mut decided = 0;
    let calls = heap_calls(|| {
        let plan = Plan::load(plan).expect("a golden plan");
        let mut policy = PlanPolicy::new(plan, &mut arena.0).expect("an arena that fits");
        for number in 0..count {
            policy.plan().warm();
            let decision = policy.decide(&Observation {
                rows: &rows,
                stride: 6,
                last_actions: &[0, 3, NO_ACTION],
                visible: EntityMask::from_words(&[number as u64 % 32]),
                self_index: number / 32 % 5,
                available: &[1, 1, 0, 1],
            });
            decided += usize::from(decision.is_ok());
        }
    });
    assert_eq!((calls, decided), (0, count));
}

#[test]
fn allocations_never_touch_the_heap() {
    let rows: Vec<f32> = (0..30).map(|number| (number % 5) as f32 / 4.0 - 0.5).collect();
    let plan = Plan::load(TEAM_VALUE).expect("a golden plan");
    let mut arena = Aligned([0; arena_bytes(TEAM_VALUE)]);
    let mut joined = vec![0.0; PlanTeamValue::memory_floats(&plan, 5)];
    let mut network =
        PlanTeamValue::new(plan, &mut arena.0, &mut joined).expect("an arena that fits");
    let (mut cells, mut values) =
        ([exact::Cell::default(); exact::cells(3, 2)], [0.0; exact::cells(3, 2)]);
    let (mut relation, mut costs) = ([0.0; 15], [0.0; 6]);
    let state = AllocationState {
        agents: 3,
        tasks: 2,
        rows: &rows,
        stride: 6,
        present: EntityMask::first(5),
        entity_task: &[0, 0, 0, 1, 2],
        open_tasks: 0b11,
        available: &[],
    };
    let count = decisions() / 100;
    let mut made = 0;
    let calls = heap_calls(|| {
        let mut allocation = [0; 3];
        for number in 0..count {
            let memory =
                SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relation };
            let mut learned = TeamValueAllocator {
                network: &mut network,
                relation: Constant(number as f32 / count as f32),
                start: LastAllocation,
                team_max: 2,
                exact_agents: [8, 0][number % 2],
                memory,
            };
            made += usize::from(learned.allocate(&state, &mut allocation).is_ok());
            let method = [CostMethod::Greedy, CostMethod::Hungarian][number % 2];
            let (model, team_max) = (Constant(1.0), 2);
            let mut by_cost = CostAllocator { model, method, team_max, costs: &mut costs };
            made += usize::from(by_cost.allocate(&state, &mut allocation).is_ok());
        }
    });
    assert_eq!((calls, made), (0, 2 * count));
}

#[test]
fn policies_never_touch_the_heap() {
    let features: Vec<f32> = (0..70).map(|number| (number % 5) as f32 / 4.0 - 0.5).collect();
    let (mask, mut arena) = ([0.0; 7], Aligned([0; arena_bytes(POLICY)]));
    let count = decisions() / 100;
    let mut made = 0;
    let calls = heap_calls(|| {
        let mut output = [0.0; 6];
        for number in 0..count {
            let plan = Plan::load(POLICY).expect("a golden plan");
            let inputs: &[&[f32]] = &[&features, &mask];
            let responded = plan.respond(&mut arena.0, inputs, &mut [], &mut [&mut output]);
            let available = [1, 1, 1, (number % 2) as u16, 1, 1];
            let given = Given { inputs, available: &available };
            let chosen = plan.choose(&mut arena.0, &given, &mut []);
            made += usize::from(responded.is_ok() && chosen.is_ok());
        }
    });
    assert_eq!((calls, made), (0, count));
}

/// The milestones of iron, by what is carried.
fn rules() -> Option<OptionRules> {
    let picture = PictureShape { channels: 9, size: 11, counts: 12, crop: 5, nearest: true };
    let signs =
        [(0, 1), (2, 4), (3, 4), (2, -4), (5, 1), (4, 1), (4, -4), (6, 1), (8, 1), (10, 1), (9, 1)];
    let affordance = Affordance::Learned;
    let milestones = signs.map(|(carried, change)| Milestone { carried, change, affordance });
    let mut rules = OptionRules::new(picture, 11, 51, &milestones)?;
    (rules.action_chance, rules.goal_chance, rules.seed) = (0.05, 0.05, 3);
    Some(rules)
}

#[test]
fn options_never_touch_the_heap() {
    let mut arena = Aligned([0; arena_bytes(CONTROLLER)]);
    assert!(arena_bytes(META).max(arena_bytes(AFFORDANCE)) <= arena.0.len());
    let (mut shown, mut memory) = ([0.0; 1386], [0.0; 78]);
    let mut row = [0.0; 1101];
    let count = decisions() / 100;
    let (mut made, mut began) = (0, 0);
    let calls = heap_calls(|| {
        let plans = [CONTROLLER, META, AFFORDANCE].map(|plan| Plan::load(plan).expect("a plan"));
        let networks = PlanNetworks::new(plans, &mut arena.0).expect("an arena that fits");
        let rules = rules().expect("sound rules");
        let mut policy = OptionPolicy::new(rules, networks, &mut shown[..]).expect("a row");
        for number in 0..count {
            row[number * 7 % 1101] = (number % 2) as f32;
            row[1089] = (number / 40) as f32;
            let seen = Observation {
                rows: &row,
                stride: 1101,
                last_actions: &[],
                visible: EntityMask::first(1),
                self_index: 0,
                available: &[1; 11],
            };
            made += usize::from(policy.decide_with(&seen, &mut memory).is_ok());
            began += usize::from(Pursuit::of(&memory).is_some_and(|pursuit| pursuit.steps == 1));
        }
    });
    assert_eq!((calls, made), (0, count));
    assert!(began > count / 51, "{began}");
}

#[test]
fn proposals_never_touch_the_heap() {
    let rows: Vec<f32> = (0..35).map(|number| (number % 5) as f32 / 4.0 - 0.5).collect();
    let mut arena = Aligned([0; arena_bytes(PROPOSALS)]);
    let mut state = AllocationState {
        agents: 3,
        tasks: 3,
        rows: &rows,
        stride: 7,
        present: EntityMask::first(5),
        entity_task: &[1, 0, 4, 1, 2],
        open_tasks: 0b111,
        available: &[],
    };
    let count = decisions() / 100;
    let mut made = 0;
    let calls = heap_calls(|| {
        let mut allocation = [0; 3];
        for number in 0..count {
            state.open_tasks = 1 + number as u32 % 7;
            let plan = Plan::load(PROPOSALS).expect("a golden plan");
            let allocator = ProposalAllocator::new(plan, &mut arena.0, 1 + number % 32, 1);
            let mut allocator = allocator.expect("an arena that fits");
            made += usize::from(allocator.allocate(&state, &mut allocation).is_ok());
        }
    });
    assert_eq!((calls, made), (0, count));
}

#[test]
fn pointing_never_touches_the_heap() {
    let rows: Vec<f32> = (0..70).map(|number| (number % 5) as f32 / 4.0 - 0.5).collect();
    let mut arena = Aligned([0; arena_bytes(ENCODER) + arena_bytes(DECODER)]);
    let plans = || [ENCODER, DECODER].map(|plan| Plan::load(plan).expect("a golden plan"));
    let [encoder, decoder] = plans();
    let mut memory = vec![0.0; PointingAllocator::memory_floats([&encoder, &decoder])];
    let rules = PointingRules { exclusive: 0b011, first_action: 1 };
    let mut state = AllocationState {
        agents: 2,
        tasks: 3,
        rows: &rows,
        stride: 14,
        present: EntityMask::first(5),
        entity_task: &[1, 0, 4, 1, 2],
        open_tasks: 0b111,
        available: &[1; 8],
    };
    let count = decisions() / 100;
    let mut made = 0;
    let calls = heap_calls(|| {
        let mut allocation = [0; 2];
        for number in 0..count {
            state.open_tasks = 1 + number as u32 % 7;
            let allocator = PointingAllocator::new(plans(), rules, &mut arena.0, &mut memory);
            let mut allocator = allocator.expect("an arena that fits");
            made += usize::from(allocator.allocate(&state, &mut allocation).is_ok());
        }
    });
    assert_eq!((calls, made), (0, count));
}
