//! The region that all processes of a domain map: 8,192 bytes of counters. A process may die at
//! any instruction without leaving them inconsistent, and zeros are their valid first state.

use std::fs::OpenOptions;
use std::num::NonZeroU32;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use memmap2::MmapRaw;
use rustix::thread::{Timespec, futex};
use sortie_core::link::Clock;
use sortie_core::{limits, wire};

use super::algorithm::Memory;
use crate::clock::MonotonicClock;
use crate::domain::{Domain, SHARED_MEMORY};
use crate::error::Error;

/// Bytes of the region.
const BYTES: usize = 8_192;
/// First bytes of the region.
const MAGIC: u64 = u64::from_le_bytes(*b"SRTIBELL");
/// Bells of the roles; of single agents from here.
const FIRST_AGENT: usize = 8;
/// Bells of the region.
const BELLS: usize = BYTES / 64 - 1;
const _: () = assert!(FIRST_AGENT + limits::AGENTS <= BELLS);

/// One bell.
#[repr(C, align(64))]
pub(super) struct Bell {
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
pub(super) struct Region {
    mapping: MmapRaw,
}

impl Region {
    /// Opens the region of a domain that this process has entered; whoever comes first creates it.
    pub(super) fn open(domain: &Domain) -> Result<Self, Error> {
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
    pub(super) fn bell(&self, index: usize) -> Option<&Bell> {
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

impl Memory for Bell {
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

    fn let_others_run(&self) {
        std::thread::yield_now();
    }

    fn now_ns(&self) -> u64 {
        MonotonicClock.now_ns()
    }
}

#[cfg(test)]
mod tests {
    use super::super::algorithm::{Wait, ring, wait};
    use super::*;

    #[test]
    fn a_page_of_another_abi_is_refused_and_stays_what_it_is() {
        let domain = Domain::new(&format!("page-{}", std::process::id())).unwrap();
        let _member = domain.enter().unwrap();
        let region = Region::open(&domain).unwrap();
        Region::open(&domain).unwrap();
        region.page().abi.store(2, Ordering::SeqCst);
        for _ in 0..2 {
            let refused = Region::open(&domain).unwrap_err().to_string();
            assert!(refused.ends_with("is no doorbell of ABI 1: 4c4c454249545253, 2"), "{refused}");
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
}
