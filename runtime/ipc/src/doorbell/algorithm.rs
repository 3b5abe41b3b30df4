//! Ringing and waiting, written once over any memory: the region of a domain, or the model that
//! explores every interleaving (`tests/proofs/doorbell`).
//!
//! Ringers never write the count of waiters. With a flag that ringers clear instead, one ringer
//! can clear what announces a waiter to another, and that one wakes nobody.

/// One bell. All accesses are sequentially consistent.
pub(crate) trait Memory {
    /// The sequence number.
    fn sequence(&self) -> u32;

    /// Raises the sequence number by one; it wraps.
    fn raise_sequence(&self);

    /// How many sleep, or are about to.
    fn waiters(&self) -> u32;

    /// Counts one waiter more.
    fn add_waiter(&self);

    /// Counts one waiter less.
    fn remove_waiter(&self);

    /// Sleeps until woken or until `until_ns`; returns at once where the sequence number is not
    /// `expected`, which is looked at without a gap before sleeping. May return early.
    fn sleep(&self, expected: u32, until_ns: u64);

    /// Wakes all that sleep.
    fn wake_all(&self);

    /// Now, on the clock of `until_ns`.
    fn now_ns(&self) -> u64;
}

/// Wakes all that wait. The data comes first: whoever is woken finds it.
pub(crate) fn ring(bell: &impl Memory) {
    bell.raise_sequence();
    if bell.waiters() != 0 {
        bell.wake_all();
    }
}

/// Waits until somebody rang since the sequence number was `token`, or until `until_ns`; spins for
/// the first `spin_ns`. Returns whether somebody rang.
pub(crate) fn wait_until(bell: &impl Memory, token: u32, until_ns: u64, spin_ns: u64) -> bool {
    let spin_until_ns = match spin_ns {
        0 => 0,
        spin => bell.now_ns().saturating_add(spin),
    };
    loop {
        if bell.sequence() != token {
            return true;
        }
        let now = bell.now_ns();
        if now >= until_ns {
            return false;
        }
        if now < spin_until_ns {
            core::hint::spin_loop();
            continue;
        }
        bell.add_waiter();
        if bell.sequence() == token {
            bell.sleep(token, until_ns);
        }
        bell.remove_waiter();
    }
}
