//! Ringing and waiting, written once over any memory: the region of a domain, or the model that
//! explores every interleaving (`tests/proofs/doorbell`).
//!
//! Ringers never write what waiters announce. With a flag that ringers clear instead, one ringer
//! can clear what announces a waiter to another, and that one wakes nobody.

/// One bell. All accesses are sequentially consistent.
pub(crate) trait Memory {
    /// The sequence number.
    fn sequence(&self) -> u32;

    /// Raises the sequence number, which wraps; returns what it is then.
    fn raise_sequence(&self, by: u32) -> u32;

    /// How many sleep, or are about to.
    fn waiters(&self) -> u32;

    /// Counts one waiter more.
    fn add_waiter(&self);

    /// Counts one waiter less.
    fn remove_waiter(&self);

    /// The sequence number that the patient waiter sleeps for; 0 = there is none.
    fn patience(&self) -> u32;

    /// Announces a patient waiter, or takes the announcement back.
    fn set_patience(&self, until_sequence: u32);

    /// Sleeps until woken or until `until_ns`; returns at once where the sequence number is not
    /// `expected`, which is looked at without a gap before sleeping. May return early.
    fn sleep(&self, expected: u32, until_ns: u64);

    /// Wakes all that sleep.
    fn wake_all(&self);

    /// Now, on the clock of `until_ns`.
    fn now_ns(&self) -> u64;
}

/// One ring that is enough for every patience.
const SUMMONS: u32 = 1 << 16;

/// Wakes all that wait, a patient waiter with the last ring that it waits for. The data comes first:
/// whoever is woken finds it.
pub(crate) fn ring(bell: &impl Memory) {
    let sequence = bell.raise_sequence(1);
    if bell.waiters() != 0 || is_due(sequence, bell.patience()) {
        bell.wake_all();
    }
}

/// Wakes all that wait, however many rings they wait for.
pub(crate) fn summon(bell: &impl Memory) {
    bell.raise_sequence(SUMMONS);
    if bell.waiters() != 0 || bell.patience() != 0 {
        bell.wake_all();
    }
}

/// Whether a sequence number that wraps has reached what somebody sleeps for.
fn is_due(sequence: u32, patience: u32) -> bool {
    patience != 0 && sequence.wrapping_sub(patience) < u32::MAX / 2
}

/// What a wait is for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wait {
    /// The sequence number before looking at what the rings announce.
    pub(crate) token: u32,
    /// Rings since then that end it. A waiter for more than one is patient: a bell may have any
    /// number of waiters, of which one is patient.
    pub(crate) rings: u32,
    /// When it ends without them.
    pub(crate) until_ns: u64,
    /// How long it spins before it sleeps.
    pub(crate) spin_ns: u64,
}

/// Waits for rings, or until it is too late. Returns whether anybody rang.
pub(crate) fn wait(bell: &impl Memory, wait: Wait) -> bool {
    let Wait { token, rings, until_ns, spin_ns } = wait;
    let spin_until_ns = match spin_ns {
        0 => 0,
        spin => bell.now_ns().saturating_add(spin),
    };
    loop {
        let sequence = bell.sequence();
        if sequence.wrapping_sub(token) >= rings {
            return true;
        }
        let now = bell.now_ns();
        if now >= until_ns {
            return sequence != token;
        }
        if now < spin_until_ns {
            core::hint::spin_loop();
            continue;
        }
        if rings > 1 {
            sleep_patiently(bell, sequence, wait);
        } else {
            bell.add_waiter();
            if bell.sequence() == sequence {
                bell.sleep(sequence, until_ns);
            }
            bell.remove_waiter();
        }
    }
}

fn sleep_patiently(bell: &impl Memory, sequence: u32, wait: Wait) {
    // One ring early instead of never, where the number is the one that says that nobody waits.
    let patience = match wait.token.wrapping_add(wait.rings) {
        0 => u32::MAX,
        patience => patience,
    };
    bell.set_patience(patience);
    if bell.sequence() == sequence {
        bell.sleep(sequence, wait.until_ns);
    }
    bell.set_patience(0);
}
