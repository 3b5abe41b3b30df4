//! Decides and allocates in a function that must not block: under the realtime sanitizer any allocation, lock or
//! system call in it ends the program; under the address sanitizer any access outside the arena does.
#![cfg_attr(feature = "realtime", feature(sanitize))]

use sortie_core::allocate::{
    CostAllocator, CostMethod, CostModel, LastAllocation, PlanTeamValue, SearchMemory,
    TaskRelation, TeamValueAllocator, exact,
};
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{
    AllocateError, AllocationState, Allocator, EntityMask, NO_ACTION, Observation, include_plan,
};

const AGENT: &[u8] = include_plan!("../../../golden/plans/agent-2.0.plan");
const ODD_SIZES: &[u8] = include_plan!("../../../golden/plans/agent-odd-sizes-2.0.plan");
const TEAM_VALUE: &[u8] = include_plan!("../../../golden/plans/team-value-2.0.plan");

/// The same number everywhere.
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

/// Decides for every set of visible entities; the number of decisions.
#[cfg_attr(feature = "realtime", sanitize(realtime = "nonblocking"))]
fn decide(plan: &Plan<'_>, arena: &mut [u8], rows: &[f32]) -> usize {
    #[cfg(feature = "control")]
    std::hint::black_box(Box::new(rows.len()));
    let available = [1; 4];
    let mut decisions = 0;
    plan.warm();
    for word in 0..32_u64 {
        for self_index in 0..5 {
            let decision = plan.decide(
                arena,
                &Observation {
                    rows,
                    stride: plan.header().features as usize,
                    last_actions: &[0, 1, NO_ACTION],
                    visible: EntityMask::from_words(&[word]),
                    self_index,
                    available: available.get(..plan.actions()).unwrap_or_default(),
                },
                None,
            );
            decisions += usize::from(decision.is_ok());
        }
    }
    decisions
}

/// Allocates by the exact search, by ascent and by costs; the number of allocations.
#[cfg_attr(feature = "realtime", sanitize(realtime = "nonblocking"))]
fn allocate(
    network: &mut PlanTeamValue<'_>,
    memory: SearchMemory<'_>,
    costs: &mut [f32],
    rows: &[f32],
) -> usize {
    let state = AllocationState {
        agents: 3,
        tasks: 2,
        rows,
        stride: 6,
        present: EntityMask::first(5),
        entity_task: &[0, 0, 0, 1, 2],
        open_tasks: 0b11,
        available: &[],
    };
    let mut allocations = 0;
    let mut allocation = [0; 3];
    for exact_agents in [8, 0] {
        let memory = SearchMemory {
            cells: &mut *memory.cells,
            values: &mut *memory.values,
            relation: &mut *memory.relation,
        };
        let (relation, start, team_max) = (Constant(0.5), LastAllocation, 2);
        let mut allocator = TeamValueAllocator {
            network: &mut *network,
            relation,
            start,
            team_max,
            exact_agents,
            memory,
        };
        allocations += usize::from(allocator.allocate(&state, &mut allocation).is_ok());
    }
    for method in [CostMethod::Greedy, CostMethod::Hungarian] {
        let (model, team_max) = (Constant(1.0), 2);
        let mut allocator = CostAllocator { model, method, team_max, costs: &mut *costs };
        allocations += usize::from(allocator.allocate(&state, &mut allocation).is_ok());
    }
    allocations
}

fn main() {
    let rows: Vec<f32> = (0..5 * 7).map(|number| (number % 5) as f32 / 4.0 - 0.5).collect();
    let mut decisions = 0;
    for bytes in [AGENT, ODD_SIZES] {
        let plan = Plan::load(bytes).expect("a golden plan");
        // From the heap, where the address sanitizer guards both ends.
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        decisions += decide(&plan, arena.as_mut_slice(), &rows);
        decisions += decide(&plan.on(Build::PORTABLE), arena.as_mut_slice(), &rows);
    }
    let plan = Plan::load(TEAM_VALUE).expect("a golden plan");
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut joined = vec![0.0; PlanTeamValue::memory_floats(&plan, 5)];
    let mut network =
        PlanTeamValue::new(plan, arena.as_mut_slice(), &mut joined).expect("an arena that fits");
    let (mut cells, mut values) = (vec![exact::Cell::default(); 16], vec![0.0; 16]);
    let (mut relation, mut costs) = (vec![0.0; 15], vec![0.0; 6]);
    let memory = SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relation };
    let allocations = allocate(&mut network, memory, &mut costs, &rows);
    println!("{decisions} decisions, {allocations} allocations");
    assert_eq!((decisions, allocations), (4 * 160, 4));
}
