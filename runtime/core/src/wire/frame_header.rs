//! The header of a frame; iceoryx2 carries it as the user header beside the payload.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::{ABI, assert_layout};

/// Header of every frame.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout,
)]
#[repr(C, align(64))]
pub struct FrameHeader {
    /// [`FrameHeader::MAGIC`].
    pub magic: u32,
    /// [`ABI`].
    pub abi: u16,
    /// A [`FrameKind`].
    pub kind: u16,
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// One more with every message of this publisher.
    pub seq: u64,
    /// `world_term << 32` + count: one more with every frame, never used twice.
    pub tick: u64,
    /// Time of publishing, in nanoseconds of the domain's clock.
    pub t_ns: u64,
    /// Time until which actions count; 0 = the world waits for all.
    pub deadline_ns: u64,
    /// Bytes of the payload.
    pub len: u32,
    /// A set of the flags named below.
    pub flags: u16,
    /// How often the team has changed its bundle: all who answer this frame decide by that generation's.
    pub generation: u16,
    /// Leadership term of the world.
    pub world_term: u32,
    /// Episode, its low 32 bits.
    pub episode: u32,
}

assert_layout!(FrameHeader, 64, {
    magic: 0, abi: 4, kind: 6, schema: 8, seq: 16, tick: 24, t_ns: 32, deadline_ns: 40,
    len: 48, flags: 52, generation: 54, world_term: 56, episode: 60,
});

impl FrameHeader {
    /// "SORT" in the first bytes.
    pub const MAGIC: u32 = 0x5452_4F53;

    /// First frame of an episode: recurrent state, last actions and subtasks start anew.
    pub const EPISODE_START: u16 = 1;
    /// The allocator is asked for a new allocation of this frame.
    pub const REALLOC: u16 = 2;
    /// Last observation of an episode; asks for no action.
    pub const EPISODE_END: u16 = 4;
    /// The world stands still; asks for no action.
    pub const PAUSED: u16 = 8;
    /// A recorded frame that is played back.
    pub const REPLAY: u16 = 16;
    /// The world ends; runners and the allocator end with it.
    pub const SHUTDOWN: u16 = 32;
    /// Agents act without waiting for this frame's allocation.
    pub const PIPELINED_ALLOC: u16 = 64;

    /// Whether all flags of `flags` are set.
    pub fn has(&self, flags: u16) -> bool {
        self.flags & flags == flags
    }

    /// Whether the frame asks for actions: an observation that neither ends nor pauses.
    pub fn asks_for_actions(&self) -> bool {
        const SILENT: u16 = FrameHeader::EPISODE_END | FrameHeader::PAUSED | FrameHeader::SHUTDOWN;
        let is_observation =
            self.kind == FrameKind::World as u16 || self.kind == FrameKind::Private as u16;
        is_observation && self.flags & SILENT == 0
    }

    /// Whether magic, ABI and schema are those of this domain.
    pub fn fits(&self, schema: u64) -> bool {
        self.magic == Self::MAGIC && self.abi == ABI && self.schema == schema
    }
}

/// What a frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum FrameKind {
    /// All agents' observations of one tick.
    World = 1,
    /// One agent's observation only.
    Private = 2,
    /// Touched and decided on once, then forgotten: brings code, weights and pages into the caches.
    WarmUp = 3,
}
