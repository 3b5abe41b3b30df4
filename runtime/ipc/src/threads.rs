//! A team in the threads of one process, without shared memory: the newest frame and allocations
//! are handed on by pointer, and threads park until they are rung.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::Duration;

use sortie_core::limits;
use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameBlock, FrameRx, FrameTx,
    LinkError, StatRx, StatTx, Wake,
};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameFormat, FrameHeader, Role, StatMsg};
use zerocopy::IntoBytes;

use crate::doorbell::{Memory, Wait, counted_in_atomics, ring, wait};
use crate::stop::MonotonicClock;

/// Actions that wait for the world.
const ACTIONS: usize = 2 * limits::AGENTS;
/// Statuses that wait for the world.
const STATUSES: usize = 2 * limits::AGENTS;

/// The messages of a team; makes the ends of its threads.
pub struct Threads {
    topics: Arc<Topics>,
    payload_bytes: usize,
}

struct Topics {
    frames: Latest<Arc<FrameBuffer>>,
    actions: Queue<ActionMsg>,
    allocations: Allocations,
    statuses: Queue<StatMsg>,
    bells: [ParkingBell; 3],
}

impl Topics {
    fn bell(&self, role: Role) -> Option<&ParkingBell> {
        self.bells.get(role as usize)
    }
}

impl Threads {
    /// A team whose frames have this format.
    pub fn new(format: &FrameFormat) -> Self {
        let topics = Topics {
            frames: Latest::default(),
            actions: Queue::new(ACTIONS),
            allocations: Allocations::default(),
            statuses: Queue::new(STATUSES),
            bells: Default::default(),
        };
        Self { topics: Arc::new(topics), payload_bytes: format.layout.payload_bytes() }
    }

    /// The world's end; a team has one at a time.
    pub fn world(&self) -> ThreadWorld {
        ThreadWorld {
            topics: Arc::clone(&self.topics),
            buffers: Vec::new(),
            payload_bytes: self.payload_bytes,
            allocations: Vec::new(),
            rings: 1,
        }
    }

    /// A runner's end.
    pub fn agent(&self) -> ThreadAgent {
        let topics = Arc::clone(&self.topics);
        ThreadAgent { topics, frames: FrameCursor::default(), allocations: Vec::new(), rings: 1 }
    }

    /// An allocator's end.
    pub fn allocator(&self) -> ThreadAllocator {
        ThreadAllocator {
            topics: Arc::clone(&self.topics),
            frames: FrameCursor::default(),
            allocation: self.topics.allocations.slot(),
            rings: 1,
        }
    }
}

/// The world's end of a [`Threads`].
pub struct ThreadWorld {
    topics: Arc<Topics>,
    /// Frames that readers may still hold; as many as that takes.
    buffers: Vec<Arc<FrameBuffer>>,
    payload_bytes: usize,
    allocations: Vec<u64>,
    /// Rings that end the next wait.
    rings: u32,
}

/// A runner's end of a [`Threads`].
pub struct ThreadAgent {
    topics: Arc<Topics>,
    frames: FrameCursor,
    allocations: Vec<u64>,
    /// Rings that end the next wait.
    rings: u32,
}

/// An allocator's end of a [`Threads`].
pub struct ThreadAllocator {
    topics: Arc<Topics>,
    frames: FrameCursor,
    allocation: Arc<Latest<AllocMsg>>,
    /// Rings that end the next wait.
    rings: u32,
}

/// What a reader has seen, and the frame that it keeps.
#[derive(Default)]
struct FrameCursor {
    seen: u64,
    kept: Option<Arc<FrameBuffer>>,
}

impl FrameCursor {
    fn receive(&mut self, topics: &Topics, accept: &mut dyn FnMut(Frame<'_>) -> bool) -> bool {
        let Some(newest) = topics.frames.newer(&mut self.seen) else { return false };
        let accepted = accept(newest.frame());
        if accepted {
            self.kept = Some(newest);
        }
        accepted
    }
}

impl FrameTx for ThreadWorld {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        let free = self.buffers.iter_mut().position(|buffer| Arc::get_mut(buffer).is_some());
        let mut buffer = match free {
            Some(index) => self.buffers.swap_remove(index),
            None => Arc::new(FrameBuffer::new(self.payload_bytes)),
        };
        let filled = Arc::make_mut(&mut buffer).fill(fill);
        if filled.is_ok() {
            self.topics.frames.put(Arc::clone(&buffer));
        }
        self.buffers.push(buffer);
        filled
    }
}

impl ActionRx for ThreadWorld {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        while let Some(action) = self.topics.actions.pop() {
            take(&action);
        }
        Ok(())
    }
}

impl StatRx for ThreadWorld {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        while let Some(status) = self.topics.statuses.pop() {
            take(&status);
        }
        Ok(())
    }
}

impl StatTx for ThreadWorld {
    /// Nobody of the team reads what its world tells of itself.
    fn send_status(&mut self, _status: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

impl ActionTx for ThreadAgent {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.topics.actions.push(*action);
        Ok(())
    }
}

impl AllocTx for ThreadAllocator {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        self.allocation.put(*allocation);
        Ok(())
    }
}

macro_rules! reads_frames_and_tells_status {
    ($($end:ident),+) => {$(
        impl FrameRx for $end {
            fn receive_frames(
                &mut self,
                accept: &mut dyn FnMut(Frame<'_>) -> bool,
            ) -> Result<bool, LinkError> {
                Ok(self.frames.receive(&self.topics, accept))
            }

            fn frame(&self) -> Option<Frame<'_>> {
                self.frames.kept.as_deref().map(FrameBuffer::frame)
            }
        }

        impl StatTx for $end {
            fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
                self.topics.statuses.push(*status);
                Ok(())
            }
        }
    )+};
}
reads_frames_and_tells_status!(ThreadAgent, ThreadAllocator);

macro_rules! receives_allocations {
    ($($end:ident),+) => {$(
        impl AllocRx for $end {
            fn receive_allocations(
                &mut self,
                take: &mut dyn FnMut(&AllocMsg),
            ) -> Result<(), LinkError> {
                self.topics.allocations.receive(&mut self.allocations, take);
                Ok(())
            }
        }
    )+};
}
receives_allocations!(ThreadAgent, ThreadWorld);

macro_rules! waits_for_its_bell {
    ($($end:ident: $role:ident),+) => {$(
        impl Bell for $end {
            fn token(&self) -> u32 {
                self.topics.bell(Role::$role).map_or(0, Memory::sequence)
            }

            fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
                let rings = std::mem::replace(&mut self.rings, 1);
                let awaited = Wait { token, rings, until_ns };
                let is_rung = |bell| wait(bell, awaited);
                let is_rung = self.topics.bell(Role::$role).is_some_and(is_rung);
                if is_rung { Wake::Rung } else { Wake::Timeout }
            }

            fn await_rings(&mut self, rings: u32) {
                self.rings = rings.max(1);
            }

            fn ring(&mut self, role: Role) -> Result<(), LinkError> {
                ring(self.topics.bell(role).ok_or(LinkError::Bell)?);
                Ok(())
            }
        }

        impl Clock for $end {
            fn now_ns(&self) -> u64 {
                MonotonicClock.now_ns()
            }
        }
    )+};
}
waits_for_its_bell!(ThreadWorld: World, ThreadAgent: Runner, ThreadAllocator: Allocator);

#[derive(Debug, Default)]
struct ParkingBell {
    sequence: AtomicU32,
    waiters: AtomicU32,
    patience: AtomicU32,
    sleepers: Mutex<Vec<Thread>>,
}

impl ParkingBell {
    fn sleepers(&self) -> MutexGuard<'_, Vec<Thread>> {
        self.sleepers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Memory for ParkingBell {
    counted_in_atomics!();

    fn sleep(&self, expected: u32, until_ns: u64) {
        let mut sleepers = self.sleepers();
        // Under the guard: whoever rings after this empties the list after it.
        if self.sequence() != expected {
            return;
        }
        sleepers.push(std::thread::current());
        drop(sleepers);
        std::thread::park_timeout(Duration::from_nanos(until_ns.saturating_sub(self.now_ns())));
        let me = std::thread::current().id();
        self.sleepers().retain(|sleeper| sleeper.id() != me);
    }

    fn wake_all(&self) {
        self.sleepers().drain(..).for_each(|sleeper| sleeper.unpark());
    }
}

// What threads hand to each other. A lock is held while a pointer or one message is moved, never while a frame is
// written or read.

#[derive(Clone)]
struct FrameBuffer {
    header: FrameHeader,
    payload: Vec<FrameBlock>,
}

impl FrameBuffer {
    fn new(payload_bytes: usize) -> Self {
        let payload = vec![FrameBlock::zeroed(); payload_bytes.div_ceil(64)];
        Self { header: FrameHeader::default(), payload }
    }

    fn frame(&self) -> Frame<'_> {
        Frame { header: &self.header, payload: self.payload.as_bytes() }
    }

    fn fill<E>(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, E>,
    ) -> Result<(), E> {
        self.header = fill(self.payload.as_mut_bytes())?;
        Ok(())
    }
}

/// The newest value, and how many there have been.
struct Latest<T>(Mutex<(u64, Option<T>)>);

impl<T> Default for Latest<T> {
    fn default() -> Self {
        Self(Mutex::new((0, None)))
    }
}

impl<T: Clone> Latest<T> {
    fn put(&self, value: T) {
        let mut slot = whole(&self.0);
        slot.0 += 1;
        slot.1 = Some(value);
    }

    /// The newest value, if it is newer than what `seen` counts.
    fn newer(&self, seen: &mut u64) -> Option<T> {
        let slot = whole(&self.0);
        let is_newer = std::mem::replace(seen, slot.0) < slot.0;
        slot.1.as_ref().filter(|_| is_newer).cloned()
    }
}

/// Messages that wait for their only reader; the oldest gives way.
struct Queue<T> {
    waiting: Mutex<VecDeque<T>>,
    most: usize,
}

impl<T> Queue<T> {
    fn new(most: usize) -> Self {
        Self { waiting: Mutex::new(VecDeque::with_capacity(most)), most }
    }

    fn push(&self, message: T) {
        let mut waiting = whole(&self.waiting);
        if waiting.len() >= self.most {
            waiting.pop_front();
        }
        waiting.push_back(message);
    }

    fn pop(&self) -> Option<T> {
        whole(&self.waiting).pop_front()
    }
}

/// What the allocators said: the newest message of each, so that none hides another's.
#[derive(Default)]
struct Allocations(Mutex<Vec<Arc<Latest<AllocMsg>>>>);

impl Allocations {
    /// A slot for one more allocator.
    fn slot(&self) -> Arc<Latest<AllocMsg>> {
        let slot = Arc::new(Latest::default());
        whole(&self.0).push(Arc::clone(&slot));
        slot
    }

    /// Shows what `seen` does not count yet, one number for each allocator.
    fn receive(&self, seen: &mut Vec<u64>, take: &mut dyn FnMut(&AllocMsg)) {
        let slots = whole(&self.0);
        seen.resize(slots.len(), 0);
        for (slot, seen) in slots.iter().zip(seen) {
            if let Some(allocation) = slot.newer(seen) {
                take(&allocation);
            }
        }
    }
}

/// What is behind these locks is whole at any time, so a panic elsewhere spoils nothing.
fn whole<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
