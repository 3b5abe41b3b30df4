//! Whether waits linger before they sleep: as long as that pays.
//!
//! A ring that comes while a waiter lingers costs nobody a system call, and finds its core awake. A
//! ring that does not come in time costs the time that the waiter lingered; and where others want
//! the core, a waiter that let them run may get it back a whole time slice later, while one that
//! sleeps would be preferred. So what lingering gains and loses is kept account of, and once it has
//! lost more, the next waits sleep at once: for so long that little of the time is ever lost.

use std::cell::Cell;

use super::algorithm::Lingered;

/// A tenth of what a wake-up costs at least: a whole team lingers for the same tick, and one that is
/// very late is worse than many that are a little early are good.
const GAIN_NS: u64 = 2_000;
/// So much of the gains is remembered, and given at first: some time slices, for the hold-ups of every start.
const CREDIT_NS_MAX: u64 = 20_000_000;
/// Waits sleep at once for so many times what was lost.
const PAUSE_FOR_LOSS: u64 = 10_000;

/// The account of a process's waits.
#[derive(Clone, Debug)]
pub(super) struct Account {
    credit_ns: Cell<u64>,
    paused_until_ns: Cell<u64>,
}

impl Account {
    pub(super) fn new() -> Self {
        Self { credit_ns: Cell::new(CREDIT_NS_MAX), paused_until_ns: Cell::new(0) }
    }

    /// Whether a wait lingers that begins now.
    pub(super) fn is_open(&self, now_ns: u64) -> bool {
        now_ns >= self.paused_until_ns.get()
    }

    pub(super) fn enter(&self, lingered: Lingered, now_ns: u64) {
        let credit_ns = self.credit_ns.get();
        let balance_ns = match lingered {
            Lingered::Gained => Some(CREDIT_NS_MAX.min(credit_ns + GAIN_NS)),
            Lingered::Lost { ns } => credit_ns.checked_sub(ns),
        };
        self.credit_ns.set(balance_ns.unwrap_or(0));
        if let (None, Lingered::Lost { ns }) = (balance_ns, lingered) {
            let pause_ns = ns.saturating_mul(PAUSE_FOR_LOSS);
            self.paused_until_ns.set(now_ns.saturating_add(pause_ns));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IN_VAIN: Lingered = Lingered::Lost { ns: 100_000 };
    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn waits_that_always_linger_in_vain_do_so_once_a_second() {
        let account = Account::new();
        // A wait for every millisecond.
        let times = (0..100_000).map(|tick| tick * SECOND_NS / 1_000);
        let lingers = times.filter(|&now_ns| {
            let is_open = account.is_open(now_ns);
            if is_open {
                account.enter(IN_VAIN, now_ns);
            }
            is_open
        });
        // What there was at first is lost first.
        assert_eq!(lingers.count(), 200 + 100);
    }

    #[test]
    fn losses_are_forgiven_that_gains_outweigh() {
        let account = Account::new();
        for now_ns in 0..100_000 {
            assert!(account.is_open(now_ns));
            let lingered = if now_ns % 51 == 0 { IN_VAIN } else { Lingered::Gained };
            account.enter(lingered, now_ns);
        }
    }

    #[test]
    fn time_slices_lost_again_and_again_make_waits_sleep_at_once() {
        let account = Account::new();
        let held_up = Lingered::Lost { ns: 4_000_000 };
        for _ in 0..5 {
            account.enter(held_up, 0);
            assert!(account.is_open(0));
        }
        for now_ns in [0, 40 * SECOND_NS] {
            account.enter(held_up, now_ns);
            assert!(!account.is_open(now_ns + 40 * SECOND_NS - 1));
            assert!(account.is_open(now_ns + 40 * SECOND_NS));
            account.enter(Lingered::Gained, now_ns + 40 * SECOND_NS);
        }
    }
}
