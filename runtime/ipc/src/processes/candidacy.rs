//! Waiting to lead, on a thread of its own: the kernel hands the lock on the moment that its holder
//! dies, however it dies.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::domain::Lock;
use crate::error::Error;
use crate::waker::Waker;

/// A process that waits for a lock. Dropped, it no longer wants it: the thread stays behind until
/// the lock comes, and lets it go at once.
pub(super) struct Candidacy {
    shared: Arc<Shared>,
}

struct Shared {
    is_withdrawn: AtomicBool,
    outcome: Mutex<Option<Result<Lock, Error>>>,
}

impl Candidacy {
    /// Calls `wait_for_lock` on a thread, after a rest; `waker` tells when there is something to [`Self::take`].
    pub(super) fn start(
        wait_for_lock: impl FnOnce(&dyn Fn() -> bool) -> Result<Option<Lock>, Error> + Send + 'static,
        rest: Duration,
        waker: Waker,
    ) -> Result<Self, Error> {
        let shared =
            Arc::new(Shared { is_withdrawn: AtomicBool::new(false), outcome: Mutex::new(None) });
        let waiting = Arc::clone(&shared);
        let wait = move || {
            let is_wanted = || !waiting.is_withdrawn.load(Ordering::SeqCst);
            std::thread::sleep(rest);
            if !is_wanted() {
                return;
            }
            if let Some(outcome) = wait_for_lock(&is_wanted).transpose() {
                let mut told = waiting.outcome();
                // Under the guard: a withdrawal comes before, or empties it after.
                *told = is_wanted().then_some(outcome);
                drop(told);
                waker.wake();
            }
        };
        let builder = std::thread::Builder::new().name("candidacy".into());
        builder.spawn(wait).map_err(Error::io("start", "candidacy"))?;
        Ok(Self { shared })
    }

    /// The lock, once.
    pub(super) fn take(&self) -> Result<Option<Lock>, Error> {
        self.shared.outcome().take().transpose()
    }
}

impl Drop for Candidacy {
    fn drop(&mut self) {
        self.shared.is_withdrawn.store(true, Ordering::SeqCst);
        self.shared.outcome().take();
    }
}

impl Shared {
    /// What is stored is whole at any time, so a panic elsewhere spoils nothing.
    fn outcome(&self) -> MutexGuard<'_, Option<Result<Lock, Error>>> {
        self.outcome.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
