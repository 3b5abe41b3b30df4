//! The floor: one page of shared memory and two futexes, no checks, no types, no discovery.
//!
//! Its world sleeps until the next answer, or until the last; or everybody looks again and again for
//! a while before they sleep.

use std::fs::OpenOptions;
use std::num::NonZeroU32;
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Instant;

use memmap2::MmapRaw;
use rustix::thread::futex;

use super::{AGENTS, FRAME_WORDS, LINGER, decide};

/// How a floor waits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Waiting {
    /// The world is woken by every answer.
    Sleep,
    /// The world is woken by the last answer only.
    Patience,
    /// All look for a while before they sleep, and let others run in between.
    Linger,
}

impl Waiting {
    pub(crate) fn lingers(self) -> bool {
        self == Self::Linger
    }
}

/// The tick that ends the agents.
const END: u64 = u64::MAX;

#[repr(C, align(64))]
struct Word {
    sequence: AtomicU32,
    waiters: AtomicU32,
    /// The sequence number that the waiter sleeps for; 0 = the next.
    patience: AtomicU32,
}

#[repr(C, align(64))]
struct Slot(AtomicU64);

#[repr(C, align(64))]
struct Memory {
    agents: Word,
    world: Word,
    tick: Slot,
    frame: [AtomicU64; FRAME_WORDS],
    actions: [Slot; AGENTS],
}

struct Mapping(MmapRaw);

impl Mapping {
    fn open(path: &Path) -> Self {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let file = options.open(path).unwrap();
        file.set_len(size_of::<Memory>() as u64).unwrap();
        Self(MmapRaw::map_raw(&file).unwrap())
    }

    fn memory(&self) -> &Memory {
        // SAFETY: the mapping is page-aligned, as long as a `Memory`, and lives as long as `self`;
        // a `Memory` is atomics only, so any bytes are valid and others may write them.
        unsafe { &*self.0.as_ptr().cast::<Memory>() }
    }
}

impl Word {
    fn ring(&self) {
        let sequence = self.sequence.fetch_add(1, Ordering::SeqCst) + 1;
        let is_due = sequence >= self.patience.load(Ordering::SeqCst);
        if self.waiters.load(Ordering::SeqCst) != 0 && is_due {
            let _ = futex::wake(&self.sequence, futex::Flags::empty(), i32::MAX as u32);
        }
    }

    fn wait(&self, token: u32, lingers: bool) {
        let began = Instant::now();
        while lingers && began.elapsed() < LINGER {
            std::thread::yield_now();
            if self.sequence.load(Ordering::SeqCst) != token {
                return;
            }
        }
        while self.sequence.load(Ordering::SeqCst) == token {
            self.waiters.fetch_add(1, Ordering::SeqCst);
            let all = NonZeroU32::MAX;
            let _ = futex::wait_bitset(&self.sequence, futex::Flags::empty(), token, None, all);
            self.waiters.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

/// A process with so many agents: answers every tick until the last.
pub(crate) fn process(path: &Path, agents: usize, index: usize, lingers: bool) {
    let mapping = Mapping::open(path);
    let memory = mapping.memory();
    let mut seen = 0;
    loop {
        let token = memory.agents.sequence.load(Ordering::SeqCst);
        let tick = memory.tick.0.load(Ordering::Acquire);
        if tick == END {
            return;
        }
        if tick == seen {
            memory.agents.wait(token, lingers);
            continue;
        }
        seen = tick;
        let sum = memory.frame.iter().fold(0, |sum, word| sum ^ word.load(Ordering::Relaxed));
        decide(agents as u32);
        std::hint::black_box(sum);
        memory.actions[index].0.store(tick, Ordering::Release);
        memory.world.ring();
    }
}

/// The world: times so many ticks of so many processes, in nanoseconds.
pub(crate) fn world(path: &Path, ticks: usize, processes: usize, waiting: Waiting) -> Vec<u64> {
    let mapping = Mapping::open(path);
    let memory = mapping.memory();
    let mut times = Vec::with_capacity(ticks);
    for tick in 1..=ticks as u64 {
        let started = Instant::now();
        for word in &memory.frame {
            word.store(tick, Ordering::Relaxed);
        }
        memory.tick.0.store(tick, Ordering::Release);
        if waiting == Waiting::Patience {
            // All answers of the ticks before are in: every agent rings once more.
            memory.world.patience.store((processes * tick as usize) as u32, Ordering::SeqCst);
        }
        memory.agents.ring();
        loop {
            let token = memory.world.sequence.load(Ordering::SeqCst);
            let answers = &memory.actions[..processes];
            if answers.iter().all(|slot| slot.0.load(Ordering::Acquire) == tick) {
                break;
            }
            memory.world.wait(token, waiting.lingers());
        }
        times.push(started.elapsed().as_nanos() as u64);
    }
    memory.tick.0.store(END, Ordering::Release);
    memory.agents.ring();
    times
}
