//! The time of embassy, by the timer that every Cortex-M has: for a board that has no crate of embassy's own.

use core::cell::RefCell;
use core::task::Waker;

use cortex_m::Peripherals;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;
use critical_section::Mutex;
use embassy_time_driver::{Driver, TICK_HZ, time_driver_impl};
use embassy_time_queue_utils::Queue;

/// Of the board that QEMU knows as mps2-an386.
const CLOCK_HZ: u64 = 25_000_000;

struct Timer(Mutex<RefCell<Time>>);

struct Time {
    now: u64,
    /// Who waits, and until when.
    waiting: Queue,
}

time_driver_impl!(static TIMER: Timer = Timer(Mutex::new(RefCell::new(Time { now: 0, waiting: Queue::new() }))));

impl Driver for Timer {
    fn now(&self) -> u64 {
        critical_section::with(|section| self.0.borrow_ref(section).now)
    }

    /// Every tick looks who is to be woken, so that nothing has to be set.
    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|section| {
            self.0.borrow_ref_mut(section).waiting.schedule_wake(at, waker);
        });
    }
}

/// Lets it run, with an interrupt every tick.
pub fn start() {
    if let Some(mut board) = Peripherals::take() {
        board.SYST.set_clock_source(SystClkSource::Core);
        board.SYST.set_reload((CLOCK_HZ / TICK_HZ) as u32 - 1);
        board.SYST.clear_current();
        board.SYST.enable_interrupt();
        board.SYST.enable_counter();
    }
}

#[exception]
fn SysTick() {
    critical_section::with(|section| {
        let mut time = TIMER.0.borrow_ref_mut(section);
        time.now += 1;
        let now = time.now;
        time.waiting.next_expiration(now);
    });
}
