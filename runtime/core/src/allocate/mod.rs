//! Who works on which subtask: the search of the team-value allocator, [`proposals`] of a policy that a critic chooses
//! among, networks that are [`pointing`] at subtasks, and allocation by [`cost`].
//!
//! For the search an allocation is valued as the sum over the open subtasks of `f(subtask, its team)`, teams without
//! agents included: what happens if nobody comes is worth knowing. [`exact`] finds the best of all
//! allocations of up to [`exact::AGENTS`] agents, [`ascent`] improves a given one for more. Both are
//! total: whatever the values, NaN and infinities among them, every agent gets an open subtask, or
//! [`UNASSIGNED`](crate::UNASSIGNED) where no open subtask has room for it. Neither allocates, draws or
//! reads a clock.
//!
//! Compared with the dissertation (section 7.4), search replaces the proposal network and a sum of one value per
//! subtask the critic; [`proposals`] is the dissertation's own allocator.

pub mod ascent;
pub mod cost;
pub mod exact;
mod plan_value;
pub mod pointing;
pub mod proposals;
pub mod team_value;

pub use cost::{CostAllocator, CostMethod, CostModel};
pub use plan_value::PlanTeamValue;
#[cfg(feature = "alloc")]
pub use pointing::PointingMemory;
pub use pointing::{PointingAllocator, PointingRules};
pub use proposals::ProposalAllocator;
pub use team_value::{
    EXACT_AGENTS, LastAllocation, SearchMemory, TaskRelation, TeamQuery, TeamValueAllocator,
    TeamValueNetwork,
};

use crate::allocator::AllocateError;
use crate::limits::{AGENTS, TASKS};

/// What is to be allocated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Teams {
    /// Number of agents A, all of them present.
    pub agents: usize,
    /// Bit t set where subtask t is open.
    pub open_tasks: u32,
    /// Largest team of one subtask; 0 leaves everybody unassigned.
    pub team_max: usize,
}

impl Teams {
    /// Agents that find room at the open subtasks.
    pub fn places(&self) -> usize {
        self.agents.min(self.team_max.saturating_mul(self.open_tasks.count_ones() as usize))
    }

    /// The open subtasks in rising order.
    fn tasks(&self) -> impl DoubleEndedIterator<Item = usize> + use<> {
        members(self.open_tasks)
    }

    fn check(&self, agents_max: usize, allocation: &[u8]) -> Result<(), AllocateError> {
        if self.agents > agents_max.min(AGENTS) {
            Err(AllocateError::TooLarge)
        } else if allocation.len() != self.agents {
            Err(AllocateError::BadLength)
        } else {
            Ok(())
        }
    }
}

/// The members of a set of subtasks in rising order.
fn members(tasks: u32) -> Members {
    Members(tasks)
}

/// Those that are still to come. To look at every bit would be a tenth of a pointing allocator's own work.
#[derive(Clone)]
struct Members(u32);

impl Iterator for Members {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        let lowest = self.0.trailing_zeros();
        self.0 &= self.0.checked_sub(1)?;
        Some(lowest as usize)
    }
}

impl DoubleEndedIterator for Members {
    fn next_back(&mut self) -> Option<usize> {
        let highest = self.0.checked_ilog2()?;
        self.0 ^= 1 << highest;
        Some(highest as usize)
    }
}

/// What a team at a subtask is worth.
pub trait TeamValue {
    /// The value of giving `team` (bit a = agent a, may be empty) to `task`.
    fn value(&mut self, task: usize, team: u64) -> f32;

    /// Writes the values `[n]` of several `(task, team)` at once: networks are faster that way.
    fn values(&mut self, questions: &[(usize, u64)], values: &mut [f32]) {
        for ((task, team), value) in questions.iter().zip(values) {
            *value = self.value(*task, *team);
        }
    }
}

impl<F: FnMut(usize, u64) -> f32> TeamValue for F {
    fn value(&mut self, task: usize, team: u64) -> f32 {
        self(task, team)
    }
}

/// Largest magnitude of a value: the sum over all subtasks stays finite.
const VALUE_MAX: f32 = f32::MAX / TASKS as f32;

/// A value that can be added and compared: NaN counts as the lowest, infinities as the outermost.
fn comparable(value: f32) -> f32 {
    if value.is_nan() { -VALUE_MAX } else { value.clamp(-VALUE_MAX, VALUE_MAX) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strange_values_become_comparable() {
        assert_eq!(comparable(1.5), 1.5);
        assert_eq!(comparable(f32::NAN), comparable(f32::NEG_INFINITY));
        assert!((comparable(f32::INFINITY) * TASKS as f32).is_finite());
    }

    #[test]
    fn places_never_exceed_the_agents() {
        let teams = |team_max| Teams { agents: 5, open_tasks: 0b1011, team_max };
        assert_eq!([0, 1, 2, usize::MAX].map(|max| teams(max).places()), [0, 3, 5, 5]);
        assert!(teams(1).tasks().eq([0, 1, 3]));
    }
}
