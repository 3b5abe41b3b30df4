//! When a loop ends and what wakes its wait: a flag set by signals or by another thread, and the clock of the host.

use std::mem::MaybeUninit;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::{io, ptr};

use rustix::stdio::stderr;
use rustix::time::{ClockId, clock_gettime};
use signal_hook::consts::{SIGBUS, SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::low_level;
use sortie_core::link::Clock;

/// A signal that follows the first one sooner is the same wish: `timeout`, `npm` and container runners send one to
/// the process, and another to its group.
const SAME_WISH_NS: u64 = 500_000_000;

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

    /// A flag that SIGINT, SIGTERM and SIGHUP set; a second signal, half a second after the first or later, ends the
    /// process at once. Where SIGHUP is ignored, as under `nohup`, it stays so. A bus error, which a full `/dev/shm` brings, ends it with its cause and exit code 74.
    ///
    /// # Errors
    /// A handler could not be registered.
    pub fn on_signals() -> io::Result<Self> {
        Self::on_signals_saying("")
    }

    /// The same, and the first signal has these words written to standard error at once: for work that takes a while
    /// to come to an end.
    ///
    /// # Errors
    /// The same.
    pub fn on_signals_saying(words: &'static str) -> io::Result<Self> {
        let stop = Self::default();
        let first_ns = Arc::new(AtomicU64::new(0));
        // The first reading looks for the clock, which a handler had better not.
        MonotonicClock.now_ns();
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            if signal != SIGHUP || !is_ignored(signal) {
                stop.obey(signal, Arc::clone(&first_ns), words)?;
            }
        }
        explain_bus_errors()?;
        outlive_file_limits()?;
        Ok(stop)
    }

    #[allow(unsafe_code)]
    fn obey(&self, signal: i32, first_ns: Arc<AtomicU64>, words: &'static str) -> io::Result<()> {
        let stop = self.clone();
        let action = move || stop.signalled(&first_ns, MonotonicClock.now_ns(), words);
        // SAFETY: the action is async-signal-safe: it reads the clock, accesses atomics, writes to a descriptor, and
        // calls a waker, which promises no more than atomic accesses and system calls, or `_exit`. It neither
        // allocates, locks, panics nor sets `errno`: system calls here go past the C library.
        unsafe { low_level::register(signal, action) }.map(drop)
    }

    fn signalled(&self, first_ns: &AtomicU64, now_ns: u64, words: &str) {
        match first_ns.compare_exchange(0, now_ns, Ordering::SeqCst, Ordering::SeqCst) {
            Ok(_) => {
                self.stop();
                let _ = rustix::io::write(stderr(), words.as_bytes());
            }
            Err(first_ns) if now_ns.saturating_sub(first_ns) < SAME_WISH_NS => {}
            Err(_) => low_level::exit(INTERRUPTED),
        }
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

/// Whether whoever started this process wants it to ignore a signal.
#[allow(unsafe_code)]
fn is_ignored(signal: i32) -> bool {
    let mut action = MaybeUninit::<libc::sigaction>::uninit();
    // SAFETY: without a new action the call only writes the present one, to memory of that type.
    let found = unsafe { libc::sigaction(signal, ptr::null(), action.as_mut_ptr()) };
    // SAFETY: it is written where the call succeeds, and of plain numbers.
    found == 0 && unsafe { action.assume_init() }.sa_sigaction == libc::SIG_IGN
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

/// Makes a write beyond the limit of file sizes (`ulimit -f`) fail, where its signal would end the process without a word.
///
/// # Errors
/// Those of the system.
#[allow(unsafe_code)]
pub fn outlive_file_limits() -> io::Result<()> {
    // SAFETY: the action is async-signal-safe: it does nothing.
    unsafe { low_level::register(SIGXFSZ, || {}) }.map(drop)
}

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

/// Ends the wait of a link, or the next one if it does not wait now.
#[derive(Clone)]
pub struct Waker(Arc<dyn Fn() + Send + Sync>);

impl Waker {
    /// `wake` runs in signal handlers: atomic accesses and async-signal-safe system calls only.
    pub(crate) fn new(wake: impl Fn() + Send + Sync + 'static) -> Self {
        Self(Arc::new(wake))
    }

    /// Ends the wait.
    pub fn wake(&self) {
        (self.0)();
    }
}

impl std::fmt::Debug for Waker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Waker")
    }
}

/// Links whose wait can be ended from outside.
pub trait Wakeable {
    /// What ends the wait of this link.
    fn waker(&self) -> Waker;
}
