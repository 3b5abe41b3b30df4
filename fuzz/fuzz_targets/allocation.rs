//! Any state for every allocator of the runtime: a feasible allocation or a refusal, never a panic.
#![no_main]

mod input;

use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::allocate::{
    CostAllocator, CostMethod, CostModel, LastAllocation, PlanTeamValue, PointingAllocator,
    PointingRules, SearchMemory, TaskRelation, TeamValueAllocator, exact,
};
use sortie_core::plan::{Aligned, Plan, arena_bytes};
use sortie_core::{
    AllocateError, AllocationState, Allocator, EntityMask, UNASSIGNED, include_plan,
};

const TEAM_VALUE: &[u8] = include_plan!("../../tests/golden/plans/team-value-2.0.plan");
const ENCODER: &[u8] = include_plan!("../../tests/golden/plans/pointing-encoder-2.3.plan");
const DECODER: &[u8] = include_plan!("../../tests/golden/plans/pointing-decoder-2.3.plan");
const RELATIONS: usize = 3;

/// Repeats numbers of the input as costs and as relations.
struct Repeat(Vec<f32>);

impl Repeat {
    fn fill(&self, floats: &mut [f32], from: usize) {
        let numbers = self.0.iter().cycle().skip(from % self.0.len().max(1));
        floats.iter_mut().zip(numbers).for_each(|(to, number)| *to = *number);
    }
}

impl TaskRelation for Repeat {
    fn columns(&self) -> usize {
        RELATIONS
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        self.fill(relation, task);
    }
}

impl CostModel for Repeat {
    fn costs(&mut self, _: &AllocationState<'_>, costs: &mut [f32]) -> Result<(), AllocateError> {
        self.fill(costs, 0);
        Ok(())
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let (agents, tasks, team_max) = (input.up_to(66), input.up_to(33), input.up_to(5));
    let (entities, stride) = (input.up_to(130), 5 + input.up_to(14));
    let exact_agents = input.up_to(11);
    let numbers: Vec<f32> = (0..1 + input.up_to(30)).map(|_| input.float()).collect();
    let entity_task: Vec<u32> = (0..entities).map(|_| input.word() as u32).collect();
    let rows: Vec<f32> = (0..entities * stride).map(|_| input.float()).collect();
    let available: Vec<u16> = (0..input.up_to(400)).map(|_| input.up_to(2) as u16).collect();
    let state = AllocationState {
        agents,
        tasks,
        rows: &rows,
        stride,
        present: EntityMask::from_words(&[input.word(), input.word()]),
        entity_task: &entity_task,
        open_tasks: input.word() as u32,
        available: &available,
    };
    let mut costs = vec![0.0; 64 * 32];
    for method in [CostMethod::Greedy, CostMethod::Hungarian] {
        let model = Repeat(numbers.clone());
        check(&state, team_max, &mut CostAllocator { model, method, team_max, costs: &mut costs });
    }
    let plans = [ENCODER, DECODER].map(|plan| Plan::load(plan).expect("a golden plan"));
    let mut arena = Aligned([0; arena_bytes(ENCODER) + arena_bytes(DECODER)]);
    let mut floats = vec![0.0; PointingAllocator::memory_floats(plans.each_ref())];
    let rules = PointingRules { exclusive: input.word() as u32, first_action: input.up_to(9) as u16 };
    let pointing = PointingAllocator::new(plans, rules, &mut arena.0, &mut floats);
    check(&state, usize::MAX, &mut pointing.expect("an arena that fits"));
    let plan = Plan::load(TEAM_VALUE).expect("a golden plan");
    let mut arena = Aligned([0; arena_bytes(TEAM_VALUE)]);
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, 128)];
    let network = PlanTeamValue::new(plan, &mut arena.0, &mut rows).expect("an arena that fits");
    let mut cells = vec![exact::Cell::default(); exact::cells(4, 4)];
    let (mut values, mut relation) = (vec![0.0; cells.len()], vec![0.0; 128 * RELATIONS]);
    let memory = SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relation };
    let (relation, start) = (Repeat(numbers), LastAllocation);
    check(
        &state,
        team_max,
        &mut TeamValueAllocator { network, relation, start, team_max, exact_agents, memory },
    );
});

fn check(state: &AllocationState<'_>, team_max: usize, allocator: &mut dyn Allocator) {
    let mut allocation = vec![77; state.agents];
    if allocator.allocate(state, &mut allocation).is_err() {
        return;
    }
    for (agent, task) in allocation.iter().enumerate().filter(|(_, task)| **task != UNASSIGNED) {
        assert!(state.present.contains(agent));
        assert!(state.open_tasks.checked_shr((*task).into()).unwrap_or(0) & 1 == 1);
        assert!(allocation.iter().filter(|other| *other == task).count() <= team_max);
    }
}
