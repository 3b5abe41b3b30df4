//! Whether an engine gives the recorded values of teams, and takes the recorded allocations.

use sortie_bundle::{Golden, GoldenAllocation, GoldenValue};
use sortie_core::allocate::{
    EXACT_AGENTS, LastAllocation, SearchMemory, TaskRelation, TeamValueAllocator, TeamValueNetwork,
    exact,
};
use sortie_core::{AllocateError, AllocationState, Allocator};

use crate::comparison::{Comparison, TOLERANCE, cannot_run};
use crate::error::CompileError;

/// Compares values with recorded ones, a state being one input.
///
/// Another allocation counts where its total differs from that of the recorded one by more than
/// [`TOLERANCE`] allows, since engines may break near ties differently; and only where all allocations are
/// searched, since the result of the ascent depends on its start.
pub fn compare_with_golden_allocations(
    name: &str,
    network: &mut dyn TeamValueNetwork,
    golden: &Golden,
    team_max: usize,
) -> Result<Comparison, CompileError> {
    let mut comparison = Comparison::new(name);
    for case in &golden.allocations {
        let state = case.state.view();
        let mut got = Vec::new();
        for value in &case.values {
            got.push(network.value(&case.query(&state, value)).map_err(cannot_run)?);
        }
        let want: Vec<f32> = case.values.iter().map(|value| value.value).collect();
        let same = case.state.agents > EXACT_AGENTS || {
            let found = allocate(network, case, team_max).map_err(cannot_run)?;
            let found = total(network, case, &found).map_err(cannot_run)?;
            let recorded = total(network, case, &case.allocation).map_err(cannot_run)?;
            (found - recorded).abs() <= f64::from(TOLERANCE) * (1.0 + recorded.abs())
        };
        comparison.add(&got, &want, same);
    }
    Ok(comparison)
}

fn allocate(
    network: &mut dyn TeamValueNetwork,
    case: &GoldenAllocation,
    team_max: usize,
) -> Result<Vec<u8>, AllocateError> {
    let cells = exact::cells(case.state.agents, case.state.open().count());
    let (mut values, mut cells) = (vec![0.0; cells], vec![exact::Cell::default(); cells]);
    let mut relation = vec![0.0; case.state.entities() * case.relations];
    let memory = SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relation };
    let mut allocator = TeamValueAllocator {
        network,
        relation: Recorded(case),
        start: LastAllocation,
        team_max,
        exact_agents: EXACT_AGENTS,
        memory,
    };
    let mut allocation = vec![0; case.state.agents];
    allocator.allocate(&case.state.view(), &mut allocation).map(|()| allocation)
}

/// The sum of all teams' values; infinitely low for an agent at a closed subtask.
fn total(
    network: &mut dyn TeamValueNetwork,
    case: &GoldenAllocation,
    allocation: &[u8],
) -> Result<f64, AllocateError> {
    let state = case.state.view();
    let mut total = 0.0;
    for task in case.state.open() {
        let members = allocation.iter().enumerate();
        let members = members.filter(|(_, place)| usize::from(**place) == task);
        let team = members.fold(0, |team, (agent, _)| team | 1_u64 << agent);
        let query = case.query(&state, &GoldenValue { task, team, value: 0.0 });
        total += f64::from(network.value(&query)?);
    }
    Ok(total)
}

/// The relation that was recorded with a state.
struct Recorded<'a>(&'a GoldenAllocation);

impl TaskRelation for Recorded<'_> {
    fn columns(&self) -> usize {
        self.0.relations
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        for (to, from) in relation.iter_mut().zip(self.0.relation_to(task)) {
            *to = *from;
        }
    }
}
