//! Every allocator is total: any state gives a feasible allocation or a refusal with its reason.

use sortie_core::allocate::{
    CostAllocator, CostMethod, CostModel, LastAllocation, PlanTeamValue, ProposalAllocator,
    SearchMemory, TaskRelation, TeamValueAllocator, exact,
};
use sortie_core::plan::{Aligned, Plan, arena_bytes};
use sortie_core::{
    AllocateError, AllocationState, Allocator, EntityMask, UNASSIGNED, include_plan, limits,
};

const TEAM_VALUE: &[u8] = include_plan!("../../../../tests/golden/plans/team-value-2.0.plan");

const PROPOSALS: &[u8] = include_plan!("../../../../tests/golden/plans/proposals-2.0.plan");

/// Columns of a row, as many as the proposing network takes and one more than the team-value network; columns of its
/// relation.
const FEATURES: usize = 7;
const RELATIONS: usize = 3;

/// Pseudo-random numbers of a linear congruential generator.
struct Numbers(u64);

impl Numbers {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_041);
        self.0 >> 31
    }

    fn below(&mut self, bound: usize) -> usize {
        self.word() as usize % bound.max(1)
    }

    fn float(&mut self, strange: bool) -> f32 {
        const STRANGE: [f32; 6] = [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN, 1e-40, -0.0];
        match self.below(40) {
            place if strange && place < STRANGE.len() => STRANGE[place],
            _ => self.below(2001) as f32 / 1000.0 - 1.0,
        }
    }
}

/// Columns of noise, now and then with strange numbers.
struct Noise(Numbers);

impl TaskRelation for Noise {
    fn columns(&self) -> usize {
        RELATIONS
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, _: usize, relation: &mut [f32]) {
        relation.fill_with(|| self.0.float(false));
    }
}

impl CostModel for Noise {
    fn costs(&mut self, _: &AllocationState<'_>, costs: &mut [f32]) -> Result<(), AllocateError> {
        costs.fill_with(|| self.0.float(true));
        Ok(())
    }
}

/// A state of any sizes within `entities_max`, its parts not always as long as they should be.
struct Case {
    agents: usize,
    tasks: usize,
    rows: Vec<f32>,
    present: EntityMask,
    entity_task: Vec<u32>,
    open_tasks: u32,
    team_max: usize,
}

impl Case {
    fn random(numbers: &mut Numbers, entities_max: usize) -> Self {
        let agents = numbers.below(entities_max.min(limits::AGENTS) + 1);
        let entities = agents + numbers.below(entities_max - agents + 1);
        let tasks = numbers.below(7);
        let strange = numbers.below(2) == 0;
        let odd = usize::from(numbers.below(20) == 0);
        let present = EntityMask::from_words(&[
            numbers.word() | numbers.word() << 33,
            numbers.word() | numbers.word() << 33,
        ]);
        let tasks_of = |numbers: &mut Numbers| match numbers.below(4) {
            0 => numbers.word() as u32,
            _ => 1_u32.checked_shl(numbers.below(tasks + 1) as u32).unwrap_or(0),
        };
        Self {
            agents,
            tasks,
            rows: (0..(entities * FEATURES).saturating_sub(odd))
                .map(|_| numbers.float(strange))
                .collect(),
            present,
            entity_task: (0..entities).map(|_| tasks_of(numbers)).collect(),
            open_tasks: numbers.word() as u32
                & ((2 << tasks) - 1)
                & !(u32::from(odd == 0) << tasks),
            team_max: numbers.below(5),
        }
    }

    fn state(&self) -> AllocationState<'_> {
        AllocationState {
            agents: self.agents,
            tasks: self.tasks,
            rows: &self.rows,
            stride: FEATURES,
            present: self.present,
            entity_task: &self.entity_task,
            open_tasks: self.open_tasks,
            available: &[],
        }
    }
}

/// How often an allocator allocated somebody, allocated nobody, and refused.
#[derive(Debug, Default)]
struct Count {
    somebody: usize,
    nobody: usize,
    refused: usize,
}

/// Allocates and checks what comes out; `absent_agents` where those may be assigned too.
fn check(count: &mut Count, case: &Case, allocator: &mut dyn Allocator, absent_agents: bool) {
    let state = case.state();
    let mut allocation = vec![77; case.agents];
    if let Err(reason) = allocator.allocate(&state, &mut allocation) {
        assert!(!reason.to_string().is_empty());
        count.refused += 1;
        return;
    }
    let mut assigned = 0;
    for (agent, task) in allocation.iter().enumerate().filter(|(_, task)| **task != UNASSIGNED) {
        assert!(u32::from(*task) < 32 && case.open_tasks >> task & 1 == 1, "{allocation:?}");
        assert!(absent_agents || case.present.contains(agent), "{allocation:?}");
        let team = allocation.iter().filter(|other| *other == task).count();
        assert!(absent_agents || team <= case.team_max, "{allocation:?}");
        assigned += 1;
    }
    if assigned > 0 { count.somebody += 1 } else { count.nobody += 1 }
}

#[test]
fn the_team_value_allocator_is_total_with_a_network() {
    let plan = Plan::load(TEAM_VALUE).expect("a golden plan");
    let mut arena = Aligned([0; arena_bytes(TEAM_VALUE)]);
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, 16)];
    let mut network =
        PlanTeamValue::new(plan, &mut arena.0, &mut rows).expect("an arena that fits");
    let mut cells = vec![exact::Cell::default(); exact::cells(5, 6)];
    let (mut values, mut relation) = (vec![0.0; cells.len()], vec![0.0; 16 * RELATIONS]);
    let mut count = Count::default();
    for seed in 0..3_000 {
        let mut numbers = Numbers(seed);
        let case = Case::random(&mut numbers, if seed % 4 == 0 { 18 } else { 6 });
        let mut allocator = TeamValueAllocator {
            network: &mut network,
            relation: Noise(Numbers(seed)),
            start: LastAllocation,
            team_max: case.team_max,
            exact_agents: [0, 3, usize::MAX][numbers.below(3)],
            memory: SearchMemory {
                cells: &mut cells,
                values: &mut values,
                relation: &mut relation,
            },
        };
        check(&mut count, &case, &mut allocator, false);
    }
    let Count { somebody, nobody, refused } = count;
    assert!(somebody > 100 && nobody > 100 && refused > 100, "{count:?}");
}

#[test]
fn the_proposing_allocator_is_total_with_its_networks() {
    let plan = Plan::load(PROPOSALS).expect("a golden plan");
    let mut arena = Aligned([0; arena_bytes(PROPOSALS)]);
    let mut count = Count::default();
    for seed in 0..3_000 {
        let mut numbers = Numbers(seed);
        let mut case = Case::random(&mut numbers, if seed % 4 == 0 { 7 } else { 5 });
        // Its teams may be of any size.
        case.team_max = usize::MAX;
        let proposals = 1 + numbers.below(32);
        let allocator = ProposalAllocator::new(plan.clone(), &mut arena.0, proposals, seed);
        check(&mut count, &case, &mut allocator.expect("an arena that fits"), false);
    }
    let Count { somebody, nobody, refused } = count;
    assert!(somebody > 100 && nobody > 100 && refused > 100, "{count:?}");
}

#[test]
fn cost_allocators_are_total() {
    let mut memory = vec![0.0; 64 * 6];
    for method in [CostMethod::Greedy, CostMethod::Hungarian] {
        let mut count = Count::default();
        for seed in 0..1_000 {
            let mut numbers = Numbers(seed);
            let case = Case::random(&mut numbers, 128);
            let model = Noise(numbers);
            let team_max = case.team_max;
            let mut allocator = CostAllocator { model, method, team_max, costs: &mut memory };
            check(&mut count, &case, &mut allocator, false);
        }
        let Count { somebody, nobody, refused } = count;
        assert!(somebody > 100 && nobody > 100 && refused > 10, "{method:?}: {count:?}");
    }
}

#[test]
fn the_last_allocation_is_total() {
    let mut count = Count::default();
    for seed in 0..1_000 {
        let case = Case::random(&mut Numbers(seed), 128);
        check(&mut count, &case, &mut LastAllocation, true);
    }
    assert!(count.somebody > 100 && count.nobody > 10, "{count:?}");
}
