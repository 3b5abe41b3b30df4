//! How long the parts of a step take, in processor time.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Processor time of all threads together, of all steps of a level up to now.
///
/// It stands beside the reports, which are the same for every number of threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct LowLevelTimes {
    /// What comes next and its value: the targets.
    pub targets: Duration,
    /// Values and their gradients.
    pub descent: Duration,
    /// Statistics, adding up the lanes, clipping and the optimiser.
    pub optimiser: Duration,
}

/// As [`LowLevelTimes`], of the allocation level.
#[derive(Clone, Copy, Debug, Default)]
pub struct AllocationTimes {
    /// Proposing allocations.
    pub proposals: Duration,
    /// Valuing proposals, targets, and the critic's own values with their gradients.
    pub critic: Duration,
    /// The gradient of the proposal policy.
    pub policy: Duration,
    /// Statistics, adding up the lanes, clipping and the optimisers.
    pub optimiser: Duration,
}

/// Measures the calling thread's work from lap to lap: other work on the processor does not count.
#[derive(Debug)]
pub(super) struct Stopwatch(Duration);

impl Stopwatch {
    /// Begins a lap.
    pub(super) fn start() -> Self {
        Self(thread_time())
    }

    /// Ends a lap, which the next one follows.
    pub(super) fn lap(&mut self) -> Duration {
        let before = std::mem::replace(&mut self.0, thread_time());
        self.0.saturating_sub(before)
    }
}

fn thread_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}
