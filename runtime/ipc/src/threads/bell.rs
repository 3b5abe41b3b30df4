//! A bell among threads: the doorbell's algorithm, where sleeping is parking.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::Duration;

use sortie_core::link::Clock;

use crate::clock::MonotonicClock;
use crate::doorbell::Memory;

#[derive(Debug, Default)]
pub(super) struct ParkingBell {
    sequence: AtomicU32,
    waiters: AtomicU32,
    patience: AtomicU32,
    sleepers: Mutex<Vec<Thread>>,
}

impl ParkingBell {
    fn sleepers(&self) -> MutexGuard<'_, Vec<Thread>> {
        self.sleepers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Memory for ParkingBell {
    fn sequence(&self) -> u32 {
        self.sequence.load(Ordering::SeqCst)
    }

    fn raise_sequence(&self, by: u32) -> u32 {
        self.sequence.fetch_add(by, Ordering::SeqCst).wrapping_add(by)
    }

    fn waiters(&self) -> u32 {
        self.waiters.load(Ordering::SeqCst)
    }

    fn add_waiter(&self) {
        self.waiters.fetch_add(1, Ordering::SeqCst);
    }

    fn remove_waiter(&self) {
        self.waiters.fetch_sub(1, Ordering::SeqCst);
    }

    fn patience(&self) -> u32 {
        self.patience.load(Ordering::SeqCst)
    }

    fn set_patience(&self, until_sequence: u32) {
        self.patience.store(until_sequence, Ordering::SeqCst);
    }

    fn sleep(&self, expected: u32, until_ns: u64) {
        let mut sleepers = self.sleepers();
        // Under the guard: whoever rings after this empties the list after it.
        if self.sequence() != expected {
            return;
        }
        sleepers.push(std::thread::current());
        drop(sleepers);
        std::thread::park_timeout(Duration::from_nanos(until_ns.saturating_sub(self.now_ns())));
        let me = std::thread::current().id();
        self.sleepers().retain(|sleeper| sleeper.id() != me);
    }

    fn wake_all(&self) {
        self.sleepers().drain(..).for_each(|sleeper| sleeper.unpark());
    }

    fn let_others_run(&self) {
        std::thread::yield_now();
    }

    fn now_ns(&self) -> u64 {
        MonotonicClock.now_ns()
    }
}
