//! Waking the wait of one's own process: from another thread, or from a signal handler.

use std::sync::Arc;

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
