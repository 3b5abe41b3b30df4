//! A flag that ends a process loop, set by signals or by another thread.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use rustix::stdio::stderr;
use signal_hook::consts::{SIGBUS, SIGHUP, SIGINT, SIGTERM};
use signal_hook::{flag, low_level};

use crate::waker::Waker;

/// Exit code of a process that a signal interrupted.
const INTERRUPTED: i32 = 130;
/// Exit code of a process that could not write to its memory.
const INPUT_OUTPUT: i32 = 74;
/// Shared memory is filled page by page, by whoever touches a page first.
const BUS_ERROR: &[u8] = b"error: bus error: /dev/shm is full, or an object in it was cut short; free some of it and start again\n";

/// A flag that ends the loops that look at it: at once the first one that it wakes, others after
/// one heartbeat.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    flag: Arc<AtomicBool>,
    waker: Arc<OnceLock<Waker>>,
}

impl Stop {
    /// A flag that only [`Self::stop`] sets.
    pub fn new() -> Self {
        Self::default()
    }

    /// A flag that SIGINT, SIGTERM and SIGHUP set; the second signal ends the process at once. A bus error,
    /// which a full `/dev/shm` brings, ends it with its cause and exit code 74.
    ///
    /// # Errors
    /// A handler could not be registered.
    pub fn on_signals() -> io::Result<Self> {
        let stop = Self::default();
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            // In this order: the first signal finds the flag unset, sets it, and wakes the loop.
            flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(&stop.flag))?;
            flag::register(signal, Arc::clone(&stop.flag))?;
            stop.wake_on(signal)?;
        }
        explain_bus_errors()?;
        Ok(stop)
    }

    #[allow(unsafe_code)]
    fn wake_on(&self, signal: i32) -> io::Result<()> {
        let stop = self.clone();
        // SAFETY: the action is async-signal-safe: an atomic load, and a waker, which promises
        // atomic accesses and system calls. It neither allocates, locks, panics nor sets `errno`.
        unsafe { low_level::register(signal, move || stop.wake()) }.map(drop)
    }

    /// The flag itself, for loops that know nothing of this type.
    pub fn flag(&self) -> &AtomicBool {
        &self.flag
    }

    /// Ends the loops.
    pub fn stop(&self) {
        self.flag.store(true, Ordering::SeqCst);
        self.wake();
    }

    /// Whether the loops are to end.
    pub fn is_set(&self) -> bool {
        self.flag.load(Ordering::SeqCst)
    }

    /// Wakes a loop when the flag is set; the first one that asks for it.
    pub(crate) fn wakes(&self, waker: Waker) {
        let _ = self.waker.set(waker);
    }

    fn wake(&self) {
        if let Some(waker) = self.waker.get() {
            waker.wake();
        }
    }
}

#[allow(unsafe_code)]
fn explain_bus_errors() -> io::Result<()> {
    let explain = || {
        let _ = rustix::io::write(stderr(), BUS_ERROR);
        low_level::exit(INPUT_OUTPUT);
    };
    // SAFETY: the action is async-signal-safe: two system calls.
    unsafe { low_level::register(SIGBUS, explain) }.map(drop)
}
