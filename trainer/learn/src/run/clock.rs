//! The time that a run takes.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

/// Wall and processor time since the last reading.
#[derive(Debug)]
pub(crate) struct Clock {
    wall: Instant,
    cpu_s: f64,
}

impl Clock {
    /// A clock that starts now.
    pub(crate) fn start() -> Self {
        Self { wall: Instant::now(), cpu_s: process_cpu_s() }
    }

    /// Seconds of the wall and of all processors since the last call, or the start.
    pub(crate) fn lap(&mut self) -> (f64, f64) {
        let now = Self::start();
        let lap = ((now.wall - self.wall).as_secs_f64(), now.cpu_s - self.cpu_s);
        *self = now;
        lap
    }
}

/// Processor time of all threads of this process.
fn process_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
