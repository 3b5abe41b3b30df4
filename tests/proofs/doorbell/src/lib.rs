//! Explores every interleaving of the doorbell's ringers and waiters, over the product's own code.
//! A lost wake-up is a waiter that sleeps for ever: the explorer reports it as a deadlock.
#![cfg(test)]

#[path = "../../../../runtime/ipc/src/doorbell/algorithm.rs"]
mod algorithm;

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

use loom::sync::atomic::AtomicU32;
use loom::sync::atomic::Ordering::{Relaxed, SeqCst};
use loom::thread::{self, Thread};

use algorithm::{Lingered, Memory, Wait, linger, ring, summon, wait};

/// A bell, and the kernel's queue of those who sleep on it.
struct Model {
    sequence: AtomicU32,
    waiters: AtomicU32,
    patience: AtomicU32,
    /// Waiters are not counted: they set a flag, which ringers clear.
    has_flag: bool,
    /// How often waiters look before they sleep.
    looks: u64,
    /// Unknown to the explorer, as time is: passes with every look of one who lingers.
    now_ns: AtomicU64,
    /// Unknown to the explorer: what is done to it is one step with the access before.
    sleepers: Mutex<Vec<Thread>>,
}

/// Reads as a sequentially consistent load does: the newest value. The explorer knows such loads
/// as acquire loads only, which may read older ones; of a read-modify-write it knows better.
fn newest(value: &AtomicU32) -> u32 {
    value.fetch_add(0, SeqCst)
}

impl Memory for Model {
    fn sequence(&self) -> u32 {
        newest(&self.sequence)
    }

    fn raise_sequence(&self, by: u32) -> u32 {
        self.sequence.fetch_add(by, SeqCst).wrapping_add(by)
    }

    fn waiters(&self) -> u32 {
        newest(&self.waiters)
    }

    fn add_waiter(&self) {
        if self.has_flag {
            self.waiters.swap(1, SeqCst);
        } else {
            self.waiters.fetch_add(1, SeqCst);
        }
    }

    fn remove_waiter(&self) {
        if !self.has_flag {
            self.waiters.fetch_sub(1, SeqCst);
        }
    }

    fn patience(&self) -> u32 {
        newest(&self.patience)
    }

    fn set_patience(&self, until_sequence: u32) {
        self.patience.swap(until_sequence, SeqCst);
    }

    /// The kernel compares and queues in one step.
    fn sleep(&self, expected: u32, _until_ns: u64) {
        if newest(&self.sequence) == expected {
            self.sleepers.lock().unwrap_or_else(PoisonError::into_inner).push(thread::current());
            thread::park();
        }
    }

    /// The kernel empties the queue, which belongs to the address of the sequence number, in one
    /// step.
    fn wake_all(&self) {
        newest(&self.sequence);
        let mut sleepers = self.sleepers.lock().unwrap_or_else(PoisonError::into_inner);
        sleepers.drain(..).for_each(|sleeper| sleeper.unpark());
    }

    /// The explorer switches at the next access, or does not.
    fn let_others_run(&self) {
        self.now_ns.fetch_add(1, Relaxed);
    }

    fn now_ns(&self) -> u64 {
        self.now_ns.load(Relaxed)
    }
}

impl Model {
    fn new() -> Self {
        Self {
            sequence: AtomicU32::new(0),
            waiters: AtomicU32::new(0),
            patience: AtomicU32::new(0),
            has_flag: false,
            looks: 0,
            now_ns: AtomicU64::new(0),
            sleepers: Mutex::new(Vec::new()),
        }
    }

    /// Whose waiters look once more before they sleep.
    fn lingering() -> Self {
        Self { looks: 1, ..Self::new() }
    }

    /// Waits as the doorbell does.
    fn wait(&self, awaited: Wait) {
        if linger(self, awaited, self.looks) == Lingered::Gained {
            assert!(awaited.is_over(newest(&self.sequence)));
        }
        assert!(wait(self, awaited));
    }

    /// Waits for so many rings as the loops of the product do: the token before looking, a look
    /// after every wait. The first token is from before all rings.
    fn await_rings(&self, rings: u32) {
        let mut token = 0;
        while token < rings {
            self.wait(rings_since(token, 1));
            token = self.sequence();
        }
    }

    /// Sleeps through all rings but the last of so many.
    fn await_last_ring(&self, rings: u32) {
        self.wait(rings_since(0, rings));
        assert!(newest(&self.sequence) >= rings);
    }
}

fn rings_since(token: u32, rings: u32) -> Wait {
    Wait { token, rings, until_ns: u64::MAX }
}

/// Runs `ringers` threads with `ring`, and `waiters`, of which this thread is one. Explores all
/// interleavings, or those in which at most so many `switches` come where a thread could go on.
fn explore(
    (ringers, waiters): (u32, usize),
    switches: Option<usize>,
    new: fn() -> Model,
    ring: fn(&Model),
) {
    let mut explorer = loom::model::Builder::new();
    explorer.preemption_bound = explorer.preemption_bound.or(switches);
    explorer.check(move || {
        let model = Arc::new(new());
        for _ in 0..ringers {
            let model = Arc::clone(&model);
            thread::spawn(move || ring(&model));
        }
        for _ in 1..waiters {
            let model = Arc::clone(&model);
            thread::spawn(move || model.await_rings(ringers));
        }
        model.await_rings(ringers);
    });
}

#[test]
fn one_ringer_wakes_one_waiter() {
    explore((1, 1), None, Model::new, ring);
}

#[test]
fn two_ringers_wake_one_waiter() {
    explore((2, 1), None, Model::new, ring);
}

#[test]
fn one_ringer_wakes_two_waiters() {
    explore((1, 2), Some(4), Model::new, ring);
}

#[test]
fn two_ringers_wake_two_waiters() {
    explore((2, 2), Some(2), Model::new, ring);
}

#[test]
fn three_ringers_wake_one_waiter() {
    explore((3, 1), Some(3), Model::new, ring);
}

#[test]
fn one_ringer_wakes_one_waiter_that_lingers() {
    explore((1, 1), None, || Model { looks: 2, ..Model::new() }, ring);
}

#[test]
fn two_ringers_wake_one_waiter_that_lingers() {
    explore((2, 1), None, Model::lingering, ring);
}

#[test]
fn two_ringers_wake_two_waiters_that_linger() {
    explore((2, 2), Some(2), Model::lingering, ring);
}

/// Nothing but the bell orders the data.
fn find_the_data(new: fn() -> Model) {
    loom::model(move || {
        let (model, data) = (Arc::new(new()), Arc::new(AtomicU32::new(0)));
        let (rings, sends) = (Arc::clone(&model), Arc::clone(&data));
        let ringer = thread::spawn(move || {
            sends.store(1, Relaxed);
            ring(&*rings);
        });
        model.await_rings(1);
        assert_eq!(data.load(Relaxed), 1);
        ringer.join().unwrap();
        assert_eq!(model.waiters(), 0);
    });
}

#[test]
fn who_is_woken_finds_the_data() {
    find_the_data(Model::new);
}

#[test]
fn who_lingers_finds_the_data() {
    find_the_data(Model::lingering);
}

#[test]
fn a_ringer_that_dies_takes_only_its_own_ring_with_it() {
    loom::model(|| {
        let model = Arc::new(Model::new());
        let (dying, living) = (Arc::clone(&model), Arc::clone(&model));
        thread::spawn(move || dying.raise_sequence(1));
        let data = Arc::new(AtomicU32::new(0));
        let sends = Arc::clone(&data);
        thread::spawn(move || {
            sends.fetch_add(1, Relaxed);
            ring(&*living);
        });
        loop {
            let token = model.sequence();
            if newest(&data) == 1 {
                return;
            }
            assert!(wait(&*model, rings_since(token, 1)));
        }
    });
}

#[test]
fn a_waiter_that_died_asleep_costs_the_others_nothing() {
    loom::model(|| {
        let model = Arc::new(Model::new());
        model.add_waiter();
        let ringer = Arc::clone(&model);
        thread::spawn(move || ring(&*ringer));
        model.await_rings(1);
        assert_eq!(model.waiters(), 1);
    });
}

/// Explores a patient waiter among so many ringers, which waits for all their rings.
fn explore_patience(ringers: u32, switches: Option<usize>, new: fn() -> Model, ring: fn(&Model)) {
    let mut explorer = loom::model::Builder::new();
    explorer.preemption_bound = explorer.preemption_bound.or(switches);
    explorer.check(move || {
        let model = Arc::new(new());
        for _ in 0..ringers {
            let model = Arc::clone(&model);
            thread::spawn(move || ring(&model));
        }
        model.await_last_ring(ringers);
        assert_eq!(newest(&model.patience), 0);
    });
}

#[test]
fn the_last_of_two_rings_wakes_the_patient() {
    explore_patience(2, None, Model::new, ring);
}

#[test]
fn the_last_of_three_rings_wakes_the_patient() {
    explore_patience(3, Some(3), Model::new, ring);
}

#[test]
fn the_last_of_two_rings_wakes_the_patient_that_linger() {
    explore_patience(2, None, Model::lingering, ring);
}

#[test]
fn the_patient_are_woken_across_the_wrap_of_the_sequence_number() {
    // The number waited for is the one that says that nobody waits.
    let token = u32::MAX - 1;
    loom::model(move || {
        let model = Arc::new(Model { sequence: AtomicU32::new(token), ..Model::new() });
        for _ in 0..2 {
            let model = Arc::clone(&model);
            thread::spawn(move || ring(&*model));
        }
        assert!(wait(&*model, rings_since(token, 2)));
        assert_eq!(model.sequence(), 0);
    });
}

#[test]
fn summons_wake_the_patient_however_many_rings_are_missing() {
    loom::model(|| {
        let model = Arc::new(Model::new());
        let (rings, summons) = (Arc::clone(&model), Arc::clone(&model));
        thread::spawn(move || ring(&*rings));
        thread::spawn(move || summon(&*summons));
        assert!(wait(&*model, rings_since(0, 64)));
    });
}

#[test]
fn a_patient_waiter_does_not_keep_others_asleep() {
    let mut explorer = loom::model::Builder::new();
    explorer.preemption_bound = explorer.preemption_bound.or(Some(2));
    explorer.check(|| {
        let model = Arc::new(Model::new());
        for _ in 0..2 {
            let model = Arc::clone(&model);
            thread::spawn(move || ring(&*model));
        }
        let other = Arc::clone(&model);
        thread::spawn(move || other.await_rings(2));
        model.await_last_ring(2);
    });
}

/// Wrong variants, which the explorer must refute: an explorer that finds nothing proves nothing.
mod wrong {
    use super::*;

    fn with_flag() -> Model {
        Model { has_flag: true, ..Model::new() }
    }

    fn wakes_before_it_counts(model: &Model) {
        if model.waiters() != 0 {
            model.wake_all();
        }
        model.raise_sequence(1);
    }

    fn clears_the_flag(model: &Model) {
        model.raise_sequence(1);
        if model.waiters() != 0 {
            model.waiters.swap(0, SeqCst);
            model.wake_all();
        }
    }

    fn swaps_the_flag(model: &Model) {
        model.raise_sequence(1);
        if model.waiters.swap(0, SeqCst) != 0 {
            model.wake_all();
        }
    }

    #[test]
    #[should_panic(expected = "deadlock")]
    fn a_ring_that_wakes_before_it_counts_is_lost() {
        explore((1, 1), None, Model::new, wakes_before_it_counts);
    }

    /// One ringer raises; the waiter sets the flag again; the other ringer clears it and has woken
    /// nobody yet; the waiter sleeps; the first ringer sees no sleeper.
    #[test]
    #[should_panic(expected = "deadlock")]
    fn a_flag_that_ringers_clear_loses_wake_ups() {
        explore((2, 1), None, with_flag, clears_the_flag);
    }

    #[test]
    #[should_panic(expected = "deadlock")]
    fn a_flag_that_ringers_swap_loses_wake_ups() {
        explore((2, 1), None, with_flag, swaps_the_flag);
    }

    /// Two such ringers both find that the other's ring is still missing.
    fn looks_before_it_counts(model: &Model) {
        let sequence = model.sequence() + 1;
        model.raise_sequence(1);
        if model.patience() == sequence {
            model.wake_all();
        }
    }

    /// The waiter may announce itself in between, and sleep.
    fn reads_the_patience_before_it_counts(model: &Model) {
        let patience = model.patience();
        if model.raise_sequence(1) == patience {
            model.wake_all();
        }
    }

    #[test]
    #[should_panic(expected = "deadlock")]
    fn a_ring_that_does_not_know_its_own_number_is_lost_on_the_patient() {
        explore_patience(2, None, Model::new, looks_before_it_counts);
    }

    #[test]
    #[should_panic(expected = "deadlock")]
    fn a_ring_that_looks_for_the_patient_before_it_counts_is_lost() {
        explore_patience(2, None, Model::new, reads_the_patience_before_it_counts);
    }
}
