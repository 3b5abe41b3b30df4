//! What the allocator says: who works on which subtask.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::{ABI, assert_layout};
use crate::allocator::UNASSIGNED;
use crate::limits;
use crate::shape::Shape;

/// One allocation of all agents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct AllocMsg {
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// One more with every message of this publisher.
    pub seq: u64,
    /// The frame it was computed from.
    pub tick: u64,
    /// Time of sending, in nanoseconds of the domain's clock.
    pub t_ns: u64,
    /// Last tick for which agents may use it.
    pub valid_until: u64,
    /// Leadership term of the allocator.
    pub term: u32,
    /// One more with every message of a term.
    pub epoch: u32,
    /// First 4 bytes of the model's id.
    pub model: u32,
    /// Time of the allocation alone, in nanoseconds.
    pub decide_ns: u32,
    /// A.
    pub n_agents: u16,
    /// T.
    pub n_tasks: u8,
    /// [`ABI`].
    pub abi: u8,
    /// A set of the flags named below.
    pub flags: u32,
    /// Subtask of each agent, [`UNASSIGNED`] where it has none.
    pub task: [u8; limits::AGENTS],
}

assert_layout!(AllocMsg, 128, {
    schema: 0, seq: 8, tick: 16, t_ns: 24, valid_until: 32, term: 40, epoch: 44, model: 48,
    decide_ns: 52, n_agents: 56, n_tasks: 58, abi: 59, flags: 60, task: 64,
});

/// Why an allocation is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AllocationFault {
    /// ABI or schema are not this domain's.
    Foreign,
    /// Counts differ from the domain's, or an agent has a subtask that does not exist.
    Content,
}

impl AllocMsg {
    /// First allocation of this leader.
    pub const FIRST_OF_TERM: u32 = 1;
    /// Some agents do not exist in this frame, or nobody acts for them.
    pub const PARTIAL: u32 = 2;
    /// A fallback rule produced it.
    pub const HEURISTIC: u32 = 4;

    /// Allocations are ordered by this; receivers keep the largest.
    pub fn order(&self) -> (u32, u32) {
        (self.term, self.epoch)
    }

    /// The subtask of `agent`, if it has one.
    pub fn task_of(&self, agent: usize) -> Option<u8> {
        self.task.get(agent).copied().filter(|&task| task != UNASSIGNED)
    }

    /// Whether the message may be used in this domain; it is dropped otherwise, never clipped.
    ///
    /// # Errors
    /// See [`AllocationFault`].
    pub fn check(&self, schema: u64, shape: Shape) -> Result<(), AllocationFault> {
        if u16::from(self.abi) != ABI || self.schema != schema {
            return Err(AllocationFault::Foreign);
        }
        let counts =
            usize::from(self.n_agents) == shape.agents && usize::from(self.n_tasks) == shape.tasks;
        let exists = |&task: &u8| task == UNASSIGNED || usize::from(task) < shape.tasks;
        if counts && self.task.iter().take(shape.agents).all(exists) {
            Ok(())
        } else {
            Err(AllocationFault::Content)
        }
    }
}
