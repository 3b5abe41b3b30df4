//! What a bundle recorded, beside what its engines give.

use sortie_bundle::{Golden, GoldenAllocation, GoldenCase, GoldenValue};
use sortie_core::allocate::{
    EXACT_AGENTS, LastAllocation, SearchMemory, TaskRelation, TeamValueAllocator, TeamValueNetwork,
    exact,
};
use sortie_core::{AllocateError, AllocationState, Allocator, Policy, UNASSIGNED};

use crate::comparison::{
    Comparison, MOST_DISTANCE, TOLERANCE, TrueNumber, cannot_run, relative_error,
};
use crate::error::CompileError;
use crate::families::Family;
use crate::judge::{True, compare, furthest};
use crate::network::{Answer, NetworkInput};
use crate::observations::OwnedTeamQuery;

/// The name of comparisons with what a bundle recorded.
pub const GOLDEN_FAMILY: &str = "golden";

/// Recorded observations as inputs.
pub fn golden_inputs<'a>(cases: impl IntoIterator<Item = &'a GoldenCase>) -> Vec<NetworkInput> {
    cases.into_iter().map(|case| NetworkInput::from(case.observation.clone())).collect()
}

/// Compares a policy with recorded answers, which agents with memory gave with an empty one; `truths` are those of
/// [`golden_inputs`], as far as they are known.
pub fn compare_with_golden<'a>(
    policy: &mut dyn Policy,
    cases: impl IntoIterator<Item = &'a GoldenCase>,
    truths: &[Option<True>],
) -> Comparison {
    let cases: Vec<&GoldenCase> = cases.into_iter().collect();
    let answer = |case: &&GoldenCase| Answer::of_policy(policy, &case.observation.view(), &[]);
    let got: Vec<Option<Answer>> = cases.iter().map(answer).collect();
    let recorded = |case: &&GoldenCase| {
        let outputs = vec![case.utilities.clone()];
        Some(Answer { outputs, action: Some(case.action) })
    };
    let want: Vec<Option<Answer>> = cases.iter().map(recorded).collect();
    compare(&Family::of(GOLDEN_FAMILY, golden_inputs(cases)), &got, &want, truths)
}

/// The teams of a recorded state as inputs.
pub fn golden_teams(case: &GoldenAllocation) -> Vec<NetworkInput> {
    let state = case.state.view();
    let query = |value: &GoldenValue| {
        let relation = case.query(&state, value).relation.to_vec();
        let (state, task, team) = (case.state.clone(), value.task, value.team);
        NetworkInput::TeamValue(OwnedTeamQuery { state, task, team, relation })
    };
    case.values.iter().map(query).collect()
}

/// Compares values with recorded ones, a state being one input; `truths` are those of every state's teams, as far as
/// they are known.
///
/// Another allocation counts where its total differs from that of the recorded one by more than rounding accounts for,
/// since engines may break near ties differently; and only where all allocations are searched, since the result of the
/// ascent depends on its start.
///
/// # Errors
/// The network refuses a recorded state.
pub fn compare_with_golden_allocations(
    network: &mut dyn TeamValueNetwork,
    golden: &Golden,
    team_max: usize,
    truths: &[Vec<TrueNumber>],
) -> Result<Comparison, CompileError> {
    let mut comparison = Comparison::new(GOLDEN_FAMILY);
    for (index, case) in golden.allocations.iter().enumerate() {
        let state = case.state.view();
        let mut got = Vec::new();
        for value in &case.values {
            got.push(network.value(&case.query(&state, value)).map_err(cannot_run)?);
        }
        let want: Vec<f32> = case.values.iter().map(|value| value.value).collect();
        let truth = truths.get(index).filter(|truth| truth.len() == want.len());
        let same = case.state.agents > EXACT_AGENTS || {
            let found = allocate(network, case, team_max).map_err(cannot_run)?;
            let found = total(network, case, &found).map_err(cannot_run)?;
            let recorded = total(network, case, &case.allocation).map_err(cannot_run)?;
            let scatter: f64 = truth.into_iter().flatten().map(|value| value.scatter).sum();
            let known = f64::from(TOLERANCE) * (1.0 + recorded.abs());
            (found - recorded).abs() <= known.max(2.0 * MOST_DISTANCE * scatter)
        };
        let error = relative_error(&got, &want);
        match truth {
            Some(truth) => {
                let numbers = got.iter().zip(&want).zip(truth);
                let distances = numbers.map(|((got, want), truth)| truth.between(*got, *want));
                let distance = if same { furthest(distances) } else { f64::INFINITY };
                comparison.add_distance(distance, error, same);
            }
            None => comparison.add_error(error, same),
        }
    }
    Ok(comparison)
}

/// Compares the allocations of an allocator that points with the recorded ones.
pub fn compare_pointing(allocator: &mut dyn Allocator, golden: &Golden) -> Comparison {
    let mut comparison = Comparison::new(GOLDEN_FAMILY);
    for case in &golden.allocations {
        let mut allocation = vec![UNASSIGNED; case.state.agents];
        match allocator.allocate(&case.state.view(), &mut allocation) {
            Ok(()) => comparison.add_error(0.0, allocation == case.allocation),
            Err(_) => comparison.refusals_differ += 1,
        }
    }
    comparison
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
