//! What a runner answers for one agent.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::{ABI, assert_layout};

/// One agent's action of one tick.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct ActionMsg {
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// One more with every message of this publisher.
    pub seq: u64,
    /// The frame that the action answers.
    pub tick: u64,
    /// Time of sending, in nanoseconds of the domain's clock.
    pub t_ns: u64,
    /// First 4 bytes of the model's id.
    pub model: u32,
    /// Epoch of the allocation acted on.
    pub alloc_epoch: u32,
    /// The agent.
    pub agent: u16,
    /// The action, or [`NO_ACTION`](crate::NO_ACTION) where none is available.
    pub action: u16,
    /// A set of the flags named below.
    pub flags: u16,
    /// The subtask acted for, or [`UNASSIGNED`](crate::UNASSIGNED).
    pub task: u8,
    /// [`ABI`].
    pub abi: u8,
    /// Utility of the action.
    pub q: f32,
    /// Time of the decision alone, in nanoseconds; its share where agents decided together.
    pub decide_ns: u32,
    /// Term of the allocation acted on.
    pub alloc_term: u32,
    /// The runner: its process id.
    pub runner: u32,
}

assert_layout!(ActionMsg, 64, {
    schema: 0, seq: 8, tick: 16, t_ns: 24, model: 32, alloc_epoch: 36, agent: 40, action: 42,
    flags: 44, task: 46, abi: 47, q: 48, decide_ns: 52, alloc_term: 56, runner: 60,
});

impl ActionMsg {
    /// The allocation is older than the newest decision tick.
    pub const STALE_ALLOC: u16 = 1;
    /// There is no usable allocation; the agent acts unallocated.
    pub const NO_ALLOC: u16 = 2;
    /// The action was drawn to explore.
    pub const EXPLORE: u16 = 4;
    /// Sent after the frame's deadline.
    pub const LATE: u16 = 8;
    /// The runner leaves this seat; the message carries no action.
    pub const BYE: u16 = 16;
    /// The policy refused; this is the fallback action.
    pub const FALLBACK: u16 = 32;
    /// Frames were missed since the last action.
    pub const TICK_GAP: u16 = 64;
    /// Recurrent state was cleared before this decision.
    pub const STATE_RESET: u16 = 128;
    /// A guard refused the observation; with [`Self::FALLBACK`].
    pub const GUARD: u16 = 256;

    /// Whether all flags of `flags` are set.
    pub fn has(&self, flags: u16) -> bool {
        self.flags & flags == flags
    }

    /// Whether ABI and schema are those of this domain.
    pub fn fits(&self, schema: u64) -> bool {
        u16::from(self.abi) == ABI && self.schema == schema
    }
}
