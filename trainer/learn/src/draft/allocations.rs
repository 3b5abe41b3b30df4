//! Keeps allocations of a learned allocator as golden cases.

use std::cell::RefCell;

use sortie_bundle::{GoldenAllocation, GoldenValue, OwnedAllocationState};
use sortie_envs::{EntitySet, Environment, SparseRows};

use super::recorder::{EPISODES, ROUNDS};
use crate::error::LearnError;
use crate::play::evaluate;
use crate::subtasks::{Allocate, AllocatorNetworks, Subtasks, ToAllocate, allocation_state_after};

/// Golden allocations of a bundle.
const CASES: usize = 48;
/// One of so many allocations becomes golden, so that they come from many episodes.
const STRIDE: usize = 23;

/// Plays under the learned allocator and keeps some of its allocations; none where it proposes: what it draws is another
/// number's.
pub(super) fn golden_allocations(
    mut subtasks: Subtasks<'_>,
    environment: &dyn Environment,
    seed: u64,
) -> Result<Vec<GoldenAllocation>, LearnError> {
    let cases = RefCell::default();
    let Some(learned) = subtasks.allocator.take() else { return Ok(cases.take()) };
    if matches!(learned.networks, AllocatorNetworks::Proposals(_)) {
        return Ok(cases.take());
    }
    let recorder = AllocationRecorder {
        allocator: learned.allocate,
        points: matches!(learned.networks, AllocatorNetworks::Pointing(_)),
        allocations: 0,
        cases: &cases,
    };
    let mut team = subtasks.under(Box::new(recorder));
    for seed in (0..ROUNDS).map(|round| seed.wrapping_add(round)) {
        evaluate(environment, &mut team, EPISODES, seed)?;
        if cases.borrow().len() >= CASES {
            break;
        }
    }
    drop(team);
    Ok(cases.take())
}

/// Allocates, and keeps every so many-th allocation.
struct AllocationRecorder<'a> {
    allocator: Box<dyn Allocate + 'a>,
    points: bool,
    allocations: usize,
    cases: &'a RefCell<Vec<GoldenAllocation>>,
}

impl Allocate for AllocationRecorder<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<(), LearnError> {
        let ToAllocate { environment, state, random, allocation } = to;
        let before = allocation.to_vec();
        self.allocator.allocate(ToAllocate { environment, state, random, allocation })?;
        self.allocations += 1;
        if self.allocations % STRIDE == 1 && self.cases.borrow().len() < CASES {
            let mut seen = allocation_state_after(environment, state, &before);
            if !self.points {
                // Teams are worth the same whatever was in force, and whatever their agents can do.
                seen.available.clear();
                seen.entity_task[..seen.agents].fill(0);
            }
            let case = self.case((environment, state), seen, allocation);
            self.cases.borrow_mut().push(case);
        }
        Ok(())
    }
}

impl AllocationRecorder<'_> {
    /// The allocation with what it is worth at each open subtask to have its team there, nobody, or everybody.
    fn case(
        &mut self,
        (environment, state): (&dyn Environment, &[u8]),
        seen: OwnedAllocationState,
        allocation: &[u8],
    ) -> GoldenAllocation {
        let allocation = allocation[..seen.agents].to_vec();
        let relations = environment.spec().relations;
        let (mut relation, mut values) = (Vec::new(), Vec::new());
        for task in seen.open() {
            relation.extend(to_task(environment, state, task));
            let assigned = allocation.iter().enumerate();
            let team = assigned.filter(|(_, place)| usize::from(**place) == task);
            let team = team.map(|(agent, _)| 1_u64 << agent).sum();
            let everybody = (0..seen.agents).map(|agent| 1_u64 << agent).sum();
            let teams = [0, team, everybody];
            let worth = self.allocator.values(environment, state, task, &teams);
            let value = |(team, value)| GoldenValue { task, team, value };
            values.extend(teams.into_iter().zip(worth).map(value));
        }
        GoldenAllocation { state: seen, relations, relation, values, allocation }
    }
}

/// How every entity stands to a subtask, in full.
fn to_task(environment: &dyn Environment, state: &[u8], task: usize) -> Vec<f32> {
    let mut rows = SparseRows::default();
    environment.relate(state, 0, task, EntitySet::MAX, &mut rows);
    let mut dense = Vec::new();
    rows.write_all(environment.spec().relations, &mut dense);
    dense
}
