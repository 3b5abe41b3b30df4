//! Who works on which subtask: the seam between the allocator process and its rules.

use crate::entity_mask::EntityMask;
use crate::limits;

/// Marks an agent without a subtask in an allocation.
pub const UNASSIGNED: u8 = 0xFF;

/// All that an allocator sees. N entities, of which the first A are agents; d features; T subtasks.
#[derive(Clone, Copy, Debug)]
pub struct AllocationState<'a> {
    /// Number of agents A.
    pub agents: usize,
    /// Number of subtasks T.
    pub tasks: usize,
    /// Features `[N, stride]`; the first d columns of a row count.
    pub rows: &'a [f32],
    /// Columns of a row, d or more.
    pub stride: usize,
    /// The entities that exist, but for agents for which nobody acts: those are not to be counted on.
    pub present: EntityMask,
    /// `[N]`: bit t set where the entity belongs to subtask t; agents: their last allocation.
    pub entity_task: &'a [u32],
    /// Bit t set where subtask t is present and not finished.
    pub open_tasks: u32,
    /// Availability codes `[A, U]` of the agents' actions, 0 = not available; empty where nobody tells.
    pub available: &'a [u16],
}

impl AllocationState<'_> {
    /// Checks that the state is as long as it says, and that `allocation` is `[A]`.
    ///
    /// # Errors
    /// `TooLarge` beyond the [limits]; `BadLength` where something is too short, or an open subtask is none.
    pub fn check(&self, allocation: &[u8]) -> Result<(), AllocateError> {
        let Self { agents, tasks, rows, stride, entity_task, open_tasks, .. } = *self;
        let entities = entity_task.len();
        if agents > limits::AGENTS || entities > limits::ENTITIES || tasks > limits::TASKS {
            return Err(AllocateError::TooLarge);
        }
        let known = u64::from(open_tasks) >> tasks == 0;
        let fits = agents <= entities && rows.len() >= entities.saturating_mul(stride);
        let fits = known && fits && allocation.len() == agents;
        if fits { Ok(()) } else { Err(AllocateError::BadLength) }
    }
}

/// Why no allocation could be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum AllocateError {
    /// More agents, entities or subtasks than the allocator was sized for.
    TooLarge,
    /// A slice of the state or of the allocation has the wrong length.
    BadLength,
    /// A feature is not a finite number.
    NonFinite,
    /// The rules gave an agent a subtask that is not open.
    Infeasible,
}

impl core::fmt::Display for AllocateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooLarge => "more agents, entities or subtasks than the allocator was made for",
            Self::BadLength => "a part of the state or the allocation has the wrong length",
            Self::NonFinite => "a feature is not a finite number",
            Self::Infeasible => "an agent was given a subtask that is not open",
        })
    }
}

impl core::error::Error for AllocateError {}

/// Assigns agents to subtasks. Total: any state gives a feasible allocation or a refusal.
pub trait Allocator {
    /// Writes for every agent `[A]` an open subtask, or [`UNASSIGNED`]. What agents get that are not present does not count.
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError>;
}

impl<A: Allocator + ?Sized> Allocator for &mut A {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        (**self).allocate(state, allocation)
    }
}
