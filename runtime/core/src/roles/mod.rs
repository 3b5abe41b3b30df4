//! World, runner and allocator as state machines over the link traits; time comes from the link.
//!
//! Each has `poll`, which works on what has arrived and says what to wait for. A loop around it
//! takes the bell's token first, polls, and waits; nothing here blocks, allocates or panics.

mod allocator;
mod deadlines;
mod durations;
mod fallback;
mod feasible;
mod newest_allocation;
mod presence;
mod runner;
mod world;

pub use allocator::{AllocatorError, AllocatorOptions, AllocatorRole};
pub use presence::{Identity, Presence};
pub use runner::{RunnerOptions, RunnerRole};
pub use world::{TickReport, Timing, WorldError, WorldObserver, WorldOptions, WorldRole};

/// What a role wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Poll {
    /// Something was done; poll again.
    Again,
    /// A message was answered, and others were rung for it: nothing more to do before the next ring.
    Answered,
    /// Nothing to do before a ring, or before this time.
    Wait {
        /// Time of the domain's clock; [`u64::MAX`] = only a ring helps.
        until_ns: u64,
    },
    /// The role has ended.
    Ended,
}

impl Poll {
    /// Whether something was done, so that others may have something to do.
    pub fn is_progress(self) -> bool {
        matches!(self, Self::Again | Self::Answered)
    }
}

/// Only a ring helps.
const IDLE: Poll = Poll::Wait { until_ns: u64::MAX };

/// What a role has counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames (runner, allocator) or world steps worked on.
    pub ticks: u64,
    /// Frames of an episode that this reader never worked on.
    pub frame_gaps: u64,
    /// Actions for a tick that was over.
    pub late: u64,
    /// Decisions with a stale allocation.
    pub stale_allocations: u64,
    /// Actions without any usable allocation.
    pub no_allocations: u64,
    /// Fallback actions.
    pub fallbacks: u64,
    /// Messages of another schema or ABI.
    pub schema_rejects: u64,
    /// Frames, allocations and actions with content that does not exist in the domain.
    pub bad_messages: u64,
    /// Frames and allocations of an earlier term or epoch than the newest.
    pub old_term_rejects: u64,
    /// Waits that only their heartbeat ended; known to the loop around the role.
    pub bell_timeouts: u64,
    /// Messages found after such a wait: a ringer died before it rang, or a ring was lost.
    pub missed_wake_ups: u64,
    /// Times that the scheduler took the processor away; known to the loop around the role.
    pub context_switches: u64,
    /// Processes that took the place of an earlier one: runners for a world, worlds for the others.
    pub restarts_seen: u64,
    /// Clean-ups after dead processes; known to a supervisor.
    pub clean_ups: u64,
    /// Longest time that a frame came after it was due, in nanoseconds; known to a world that keeps to a rate.
    pub longest_delay_ns: u64,
    /// Periods in which no frame came, because the world was late by them; known to a world that keeps to a rate.
    pub skipped_periods: u64,
}

impl Counters {
    /// The counters of a status, in the order of the wire.
    pub(crate) fn to_wire(self) -> [u64; 16] {
        let mut counters = [0; 16];
        let known = [
            self.ticks,
            self.frame_gaps,
            self.late,
            self.stale_allocations,
            self.no_allocations,
            self.fallbacks,
            self.schema_rejects,
            self.bad_messages,
            self.old_term_rejects,
            self.bell_timeouts,
            self.missed_wake_ups,
            self.context_switches,
            self.restarts_seen,
            self.clean_ups,
            self.longest_delay_ns,
            self.skipped_periods,
        ];
        for (to, from) in counters.iter_mut().zip(known) {
            *to = from;
        }
        counters
    }
}
