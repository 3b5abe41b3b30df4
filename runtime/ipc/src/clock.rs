//! The clock that all processes of one host share.

use rustix::time::{ClockId, clock_gettime};
use sortie_core::link::Clock;

/// `CLOCK_MONOTONIC`: survives steps of the wall clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&self) -> u64 {
        let now = clock_gettime(ClockId::Monotonic);
        // Neither is negative: the clock starts at boot.
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    }
}
