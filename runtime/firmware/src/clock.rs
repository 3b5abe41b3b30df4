//! The time since the program began, by the counter of instructions.

use core::cell::Cell;

use sortie_core::link::{Clock, Processor};

use crate::machine::{MOST_TICKS, now};

/// Nanoseconds of a tick: the boards `mps2` count at 25 MHz, and an instruction of the others takes one in the emulator.
const NS_PER_TICK: u64 = if cfg!(target_arch = "arm") { 40 } else { 1 };

/// The clock: there is one counter.
pub(crate) static CLOCK: Counter = Counter { ticks: Cell::new(0), last: Cell::new(0) };

/// Ticks beyond what the counter holds; it is looked at before it has come round.
pub(crate) struct Counter {
    ticks: Cell<u64>,
    last: Cell<u32>,
}

// SAFETY: the program has one core and no interrupts.
unsafe impl Sync for Counter {}

impl Clock for Counter {
    fn now_ns(&self) -> u64 {
        let now = now();
        let passed = now.wrapping_sub(self.last.replace(now)) & MOST_TICKS;
        self.ticks.set(self.ticks.get() + u64::from(passed));
        self.ticks.get() * NS_PER_TICK
    }
}

impl Processor for Counter {}
