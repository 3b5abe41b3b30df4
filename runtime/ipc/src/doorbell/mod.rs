//! The doorbell: how processes of a domain wake each other, by counters in shared memory on which
//! the kernel lets them sleep. A ring is one system call where somebody sleeps, else none.
//!
//! Rules for its users: the token is taken before looking at the topics; data is sent before the
//! ring; after every wake all topics are looked at; every wait has a deadline of at most 100 ms.

mod algorithm;

use std::cell::Cell;
use std::fs::OpenOptions;
use std::num::NonZeroU32;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use memmap2::MmapRaw;
use rustix::thread::{Timespec, futex};
use sortie_core::limits;
use sortie_core::link::{Clock, LinkError, Wake};
use sortie_core::wire::{self, Role};

use crate::domain::{Domain, SHARED_MEMORY, nanoseconds};
use crate::error::Error;
use crate::stop::{MonotonicClock, Waker};
use algorithm::{Lingered, linger, summon};

pub(crate) use algorithm::{Memory, Wait, ring, wait};

/// One process's end of its domain's doorbell.
#[derive(Clone, Debug)]
pub struct Doorbell {
    region: Arc<Region>,
    own: usize,
    linger_ns: u64,
    account: Account,
}

impl Doorbell {
    /// Opens the doorbell of a domain that this process has entered, to be woken with its role.
    /// Waits linger for `linger` before they sleep, as long as that pays.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the role has no bell.
    pub fn open(domain: &Domain, own: Role, linger: Duration) -> Result<Self, Error> {
        let own = index(own).ok_or_else(|| Error::SharedMemory {
            what: format!("bell of {own:?}"),
            problem: "this role has none".to_string(),
        })?;
        Ok(Self {
            region: Arc::new(Region::open(domain)?),
            own,
            linger_ns: nanoseconds(linger),
            account: Account::new(),
        })
    }

    /// The state of the own bell.
    pub fn token(&self) -> u32 {
        self.region.bell(self.own).map_or(0, Memory::sequence)
    }

    /// Waits until somebody rang the own bell since `token` was taken, or until `until_ns`.
    pub fn wait_until(&self, token: u32, until_ns: u64) -> Wake {
        // A world that awaits no answers waits for a time.
        let linger_ns = if index(Role::World) == Some(self.own) { 0 } else { self.linger_ns };
        self.await_rings(Wait { token, rings: 1, until_ns }, linger_ns)
    }

    /// Waits until the own bell was rung so often since `token` was taken, or until `until_ns`. Of
    /// the processes of one role, one may wait for more than one ring.
    pub fn wait_for_rings(&self, token: u32, rings: u32, until_ns: u64) -> Wake {
        self.await_rings(Wait { token, rings, until_ns }, self.linger_ns)
    }

    fn await_rings(&self, awaited: Wait, linger_ns: u64) -> Wake {
        let Some(bell) = self.region.bell(self.own) else { return Wake::Timeout };
        if awaited.is_over(bell.sequence()) {
            return Wake::Rung;
        }
        if linger_ns != 0 && self.account.is_open(bell.now_ns()) {
            let lingered = linger(bell, awaited, linger_ns);
            self.account.enter(lingered, bell.now_ns());
        }
        if wait(bell, awaited) { Wake::Rung } else { Wake::Timeout }
    }

    /// Wakes every process of `role`.
    ///
    /// # Errors
    /// The role has no bell.
    pub fn ring(&self, role: Role) -> Result<(), LinkError> {
        let bell = index(role).and_then(|index| self.region.bell(index)).ok_or(LinkError::Bell)?;
        ring(bell);
        Ok(())
    }

    /// Wakes the processes of the own bell.
    pub(crate) fn waker(&self) -> Waker {
        let (region, own) = (Arc::clone(&self.region), self.own);
        Waker::new(move || {
            if let Some(bell) = region.bell(own) {
                summon(bell);
            }
        })
    }
}

/// The bell of a role.
fn index(role: Role) -> Option<usize> {
    match role {
        Role::World => Some(0),
        Role::Runner => Some(1),
        Role::Allocator => Some(2),
        Role::Watcher => Some(3),
        Role::Supervisor | Role::Bridge => None,
    }
}

// The region that all processes of a domain map: 8,192 bytes of counters. A process may die at
// any instruction without leaving them inconsistent, and zeros are their valid first state.

/// Bytes of the region.
const BYTES: usize = 8_192;
/// First bytes of the region.
const MAGIC: u64 = u64::from_le_bytes(*b"SRTIBELL");
/// Bells of the roles; of single agents from here.
const FIRST_AGENT: usize = 8;
/// Bells of the region.
const BELLS: usize = BYTES / 64 - 1;
const _: () = assert!(FIRST_AGENT + limits::AGENTS <= BELLS);

#[repr(C, align(64))]
struct Bell {
    sequence: AtomicU32,
    waiters: AtomicU32,
    patience: AtomicU32,
    _unused: [AtomicU32; 13],
}

#[repr(C, align(64))]
struct Page {
    magic: AtomicU64,
    /// The number of the ABI; its upper half is 0.
    abi: AtomicU64,
    _unused: [AtomicU64; 6],
    bells: [Bell; BELLS],
}
const _: () = assert!(size_of::<Page>() == BYTES && size_of::<Bell>() == 64);

/// A domain's region, mapped.
#[derive(Debug)]
struct Region {
    mapping: MmapRaw,
}

impl Region {
    /// Opens the region of a domain that this process has entered; whoever comes first creates it.
    fn open(domain: &Domain) -> Result<Self, Error> {
        let path = Path::new(SHARED_MEMORY).join(domain.bell_object());
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false).mode(0o600);
        let file = options.open(&path).map_err(Error::io("open", &path))?;
        file.set_len(BYTES as u64).map_err(Error::io("size", &path))?;
        let mapping = MmapRaw::map_raw(&file).map_err(Error::io("map", &path))?;
        let region = Self { mapping };
        let page = region.page();
        let [magic, abi] = [(&page.magic, MAGIC), (&page.abi, wire::ABI.into())]
            .map(|(word, ours)| settle(word, ours));
        if (magic, abi) == (MAGIC, wire::ABI.into()) {
            return Ok(region);
        }
        Err(Error::BadFile {
            path,
            problem: format!("is no doorbell of ABI {}: {magic:016x}, {abi}", wire::ABI),
        })
    }

    /// The bell of this index.
    fn bell(&self, index: usize) -> Option<&Bell> {
        self.page().bells.get(index)
    }

    #[allow(unsafe_code)]
    fn page(&self) -> &Page {
        // SAFETY: the mapping is page-aligned, has the size of a `Page`, and lives as long as
        // `self`, which the result borrows. A page is atomics only: any bytes are valid, and other
        // processes may write them. Nobody shortens the file: it is only ever set to this length.
        unsafe { &*self.mapping.as_ptr().cast::<Page>() }
    }
}

/// Writes `value` where nothing is written yet; returns what is there then.
fn settle(word: &AtomicU64, value: u64) -> u64 {
    match word.compare_exchange(0, value, Ordering::SeqCst, Ordering::SeqCst) {
        Ok(_) => value,
        Err(found) => found,
    }
}

/// What of [`Memory`] is the same wherever the three counters lie, and whoever sleeps.
macro_rules! counted_in_atomics {
    () => {
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

        fn let_others_run(&self) {
            std::thread::yield_now();
        }

        fn now_ns(&self) -> u64 {
            MonotonicClock.now_ns()
        }
    };
}
pub(crate) use counted_in_atomics;

impl Memory for Bell {
    counted_in_atomics!();

    fn sleep(&self, expected: u32, until_ns: u64) {
        let until = Timespec {
            tv_sec: (until_ns / 1_000_000_000) as i64,
            tv_nsec: (until_ns % 1_000_000_000) as _,
        };
        // Shared with other processes, so not private; the bit set makes the time absolute.
        // Woken, late, interrupted or too late to sleep: the caller looks at the sequence number.
        let _ = futex::wait_bitset(
            &self.sequence,
            futex::Flags::empty(),
            expected,
            Some(&until),
            NonZeroU32::MAX,
        );
    }

    fn wake_all(&self) {
        // Fails for addresses that are not mapped only.
        let _ = futex::wake(&self.sequence, futex::Flags::empty(), i32::MAX as u32);
    }
}

// Whether waits linger before they sleep: as long as that pays.
//
// A ring that comes while a waiter lingers costs nobody a system call, and finds its core awake. A
// ring that does not come in time costs the time that the waiter lingered; and where others want
// the core, a waiter that let them run may get it back a whole time slice later, while one that
// sleeps would be preferred. So what lingering gains and loses is kept account of, and once it has
// lost more, the next waits sleep at once: for so long that little of the time is ever lost.

/// A tenth of what a wake-up costs at least: a whole team lingers for the same tick, and one that is
/// very late is worse than many that are a little early are good.
const GAIN_NS: u64 = 2_000;
/// So much of the gains is remembered, and given at first: some time slices, for the hold-ups of every start.
const CREDIT_NS_MAX: u64 = 20_000_000;
/// Waits sleep at once for so many times what was lost.
const PAUSE_FOR_LOSS: u64 = 10_000;

/// The account of a process's waits.
#[derive(Clone, Debug)]
struct Account {
    credit_ns: Cell<u64>,
    paused_until_ns: Cell<u64>,
}

impl Account {
    fn new() -> Self {
        Self { credit_ns: Cell::new(CREDIT_NS_MAX), paused_until_ns: Cell::new(0) }
    }

    /// Whether a wait lingers that begins now.
    fn is_open(&self, now_ns: u64) -> bool {
        now_ns >= self.paused_until_ns.get()
    }

    fn enter(&self, lingered: Lingered, now_ns: u64) {
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
    use super::algorithm::{Wait, ring, wait};
    use super::*;

    #[test]
    fn a_page_of_another_abi_is_refused_and_stays_what_it_is() {
        let domain = Domain::new(&format!("page-{}", std::process::id())).unwrap();
        let _member = domain.enter().unwrap();
        let region = Region::open(&domain).unwrap();
        Region::open(&domain).unwrap();
        region.page().abi.store(1, Ordering::SeqCst);
        for _ in 0..2 {
            let refused = Region::open(&domain).unwrap_err().to_string();
            assert!(refused.ends_with("is no doorbell of ABI 3: 4c4c454249545253, 1"), "{refused}");
        }
    }

    #[test]
    fn a_waiter_that_died_asleep_loses_no_ring_and_keeps_nobody_waiting() {
        let domain = Domain::new(&format!("waiter-{}", std::process::id())).unwrap();
        let _member = domain.enter().unwrap();
        let region = Region::open(&domain).unwrap();
        let bell = region.bell(1).unwrap();
        // The dead are counted as long as the domain lives, which costs its ringers a call each time.
        bell.add_waiter();
        let token = bell.sequence();
        let (past, later) = (bell.now_ns(), bell.now_ns() + 60_000_000_000);
        assert!(!wait(bell, Wait { token, rings: 1, until_ns: past }), "nobody rang");
        std::thread::scope(|scope| {
            let waiter = scope.spawn(|| wait(bell, Wait { token, rings: 1, until_ns: later }));
            while bell.waiters() < 2 {
                std::thread::yield_now();
            }
            ring(bell);
            assert!(waiter.join().unwrap());
        });
        assert_eq!(bell.waiters(), 1);
        let token = bell.sequence();
        ring(bell);
        assert!(wait(bell, Wait { token, rings: 1, until_ns: later }), "a ring before the wait");
    }

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
