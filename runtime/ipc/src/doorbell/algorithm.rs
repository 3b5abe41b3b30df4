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

    /// Lets another of this core run, if one wants to.
    fn let_others_run(&self);

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
}

impl Wait {
    /// Whether this sequence number ends it.
    pub(crate) fn is_over(&self, sequence: u32) -> bool {
        sequence.wrapping_sub(self.token) >= self.rings
    }
}

/// What lingering came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lingered {
    /// The rings came.
    Gained,
    /// They did not, or others held the core for longer than a team mate would.
    Lost { ns: u64 },
}

/// Longer than a team mate that lets others run in turn, shorter than the scheduler's time slice.
const HELD_UP_NS: u64 = 1_000_000;

/// Looks for the rings again and again for so long, and lets others run in between. Nobody has to
/// wake who lingers, and the core stays awake.
pub(crate) fn linger(bell: &impl Memory, wait: Wait, linger_ns: u64) -> Lingered {
    let began_ns = bell.now_ns();
    let until_ns = began_ns.saturating_add(linger_ns).min(wait.until_ns);
    let mut looked_ns = began_ns;
    while looked_ns < until_ns {
        bell.let_others_run();
        let is_over = wait.is_over(bell.sequence());
        let now_ns = bell.now_ns();
        if is_over {
            let ns = now_ns.saturating_sub(looked_ns);
            return if ns < HELD_UP_NS { Lingered::Gained } else { Lingered::Lost { ns } };
        }
        looked_ns = now_ns;
    }
    Lingered::Lost { ns: looked_ns.saturating_sub(began_ns) }
}

/// Sleeps until the rings came, or until it is too late. Returns whether anybody rang.
pub(crate) fn wait(bell: &impl Memory, wait: Wait) -> bool {
    loop {
        let sequence = bell.sequence();
        if wait.is_over(sequence) {
            return true;
        }
        if bell.now_ns() >= wait.until_ns {
            return sequence != wait.token;
        }
        if wait.rings > 1 {
            sleep_patiently(bell, sequence, wait);
        } else {
            bell.add_waiter();
            if bell.sequence() == sequence {
                bell.sleep(sequence, wait.until_ns);
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
