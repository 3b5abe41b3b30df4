//! What a process says about itself: that it is there, and that it leaves.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::{ABI, assert_layout};

/// What a process is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Role {
    /// Steps the environment, or the robots' own sensing.
    World = 0,
    /// Acts for one or more agents, or serves a policy.
    Runner = 1,
    /// Assigns agents to subtasks.
    Allocator = 2,
    /// Starts and restarts the others.
    Supervisor = 3,
    /// Forwards topics between hosts.
    Bridge = 4,
    /// Looks on.
    Watcher = 5,
}

impl Role {
    /// The role of this number, if there is one.
    pub fn from_number(number: u8) -> Option<Self> {
        let all = [
            Self::World,
            Self::Runner,
            Self::Allocator,
            Self::Supervisor,
            Self::Bridge,
            Self::Watcher,
        ];
        all.into_iter().find(|role| *role as u8 == number)
    }

    /// Its name, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::World => "world",
            Self::Runner => "runner",
            Self::Allocator => "allocator",
            Self::Supervisor => "supervisor",
            Self::Bridge => "bridge",
            Self::Watcher => "watcher",
        }
    }
}

/// State of one process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct StatMsg {
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// One more with every message of this publisher.
    pub seq: u64,
    /// Time of sending, in nanoseconds of the domain's clock.
    pub t_ns: u64,
    /// Time of the process's start.
    pub start_ns: u64,
    /// Process id.
    pub pid: u32,
    /// A [`Role`].
    pub role: u8,
    /// [`ABI`].
    pub abi: u8,
    /// Number of agents that the process acts for.
    pub n_agents: u16,
    /// Bit a: it acts for agent a.
    pub agents: u64,
    /// Newest tick it worked on.
    pub last_tick: u64,
    /// First 16 bytes of the model's id.
    pub model: [u8; 16],
    /// Build of the program.
    pub build: u32,
    /// A set of the flags named below.
    pub flags: u32,
    /// Counters since the start, in this order: ticks, frame gaps, late, stale allocations, no allocations,
    /// fallbacks, schema rejects, bad messages, old-term rejects, bell time-outs, missed wake-ups,
    /// involuntary context switches, restarts seen, clean-ups after the dead, longest time of a frame behind its due
    /// time in nanoseconds, periods skipped.
    pub counters: [u64; 16],
    /// Times from a frame's publishing to this process running; world: from the last answer to it running.
    /// Bucket k counts those of [2^k, 2^(k+1)) times 16 ns since the start.
    pub hist_wake: [u32; 32],
    /// Times from running to publishing: a runner's actions, an allocation; world: from its running to the
    /// end of its step.
    pub hist_work: [u32; 32],
    /// Port name, zero padded.
    pub name: [u8; 48],
}

assert_layout!(StatMsg, 512, {
    schema: 0, seq: 8, t_ns: 16, start_ns: 24, pid: 32, role: 36, abi: 37, n_agents: 38,
    agents: 40, last_tick: 48, model: 56, build: 72, flags: 76, counters: 80, hist_wake: 208,
    hist_work: 336, name: 464,
});

impl StatMsg {
    /// The process joins.
    pub const HELLO: u32 = 1;
    /// The process leaves.
    pub const BYE: u32 = 2;
    /// It works below what was asked for.
    pub const DEGRADED: u32 = 4;
    /// It leads its role.
    pub const LEADER: u32 = 8;
    /// It has no plan: an engine runs its network's graph, which allocates and promises nothing about bits or time.
    pub const GRAPH: u32 = 16;

    /// Whether all flags of `flags` are set.
    pub fn has(&self, flags: u32) -> bool {
        self.flags & flags == flags
    }

    /// Whether ABI and schema are those of this domain.
    pub fn fits(&self, schema: u64) -> bool {
        u16::from(self.abi) == ABI && self.schema == schema
    }
}
