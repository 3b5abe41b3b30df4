//! What threads hand to each other. A lock is held while a pointer or one message is moved, never
//! while a frame is written or read.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sortie_core::link::{Frame, FrameBlock};
use sortie_core::wire::{AllocMsg, FrameHeader};
use zerocopy::IntoBytes;

/// One frame.
#[derive(Clone)]
pub(super) struct FrameBuffer {
    header: FrameHeader,
    payload: Vec<FrameBlock>,
}

impl FrameBuffer {
    pub(super) fn new(payload_bytes: usize) -> Self {
        let payload = vec![FrameBlock::zeroed(); payload_bytes.div_ceil(64)];
        Self { header: FrameHeader::default(), payload }
    }

    pub(super) fn frame(&self) -> Frame<'_> {
        Frame { header: &self.header, payload: self.payload.as_bytes() }
    }

    pub(super) fn fill<E>(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, E>,
    ) -> Result<(), E> {
        self.header = fill(self.payload.as_mut_bytes())?;
        Ok(())
    }
}

/// The newest value, and how many there have been.
pub(super) struct Latest<T>(Mutex<(u64, Option<T>)>);

impl<T> Default for Latest<T> {
    fn default() -> Self {
        Self(Mutex::new((0, None)))
    }
}

impl<T: Clone> Latest<T> {
    pub(super) fn put(&self, value: T) {
        let mut slot = whole(&self.0);
        slot.0 += 1;
        slot.1 = Some(value);
    }

    /// The newest value, if it is newer than what `seen` counts.
    pub(super) fn newer(&self, seen: &mut u64) -> Option<T> {
        let slot = whole(&self.0);
        let is_newer = std::mem::replace(seen, slot.0) < slot.0;
        slot.1.as_ref().filter(|_| is_newer).cloned()
    }
}

/// Messages that wait for their only reader; the oldest gives way.
pub(super) struct Queue<T> {
    waiting: Mutex<VecDeque<T>>,
    most: usize,
}

impl<T> Queue<T> {
    pub(super) fn new(most: usize) -> Self {
        Self { waiting: Mutex::new(VecDeque::with_capacity(most)), most }
    }

    pub(super) fn push(&self, message: T) {
        let mut waiting = whole(&self.waiting);
        if waiting.len() >= self.most {
            waiting.pop_front();
        }
        waiting.push_back(message);
    }

    pub(super) fn pop(&self) -> Option<T> {
        whole(&self.waiting).pop_front()
    }
}

/// What the allocators said: the newest message of each, so that none hides another's.
#[derive(Default)]
pub(super) struct Allocations(Mutex<Vec<Arc<Latest<AllocMsg>>>>);

impl Allocations {
    /// A slot for one more allocator.
    pub(super) fn slot(&self) -> Arc<Latest<AllocMsg>> {
        let slot = Arc::new(Latest::default());
        whole(&self.0).push(Arc::clone(&slot));
        slot
    }

    /// Shows what `seen` does not count yet, one number for each allocator.
    pub(super) fn receive(&self, seen: &mut Vec<u64>, take: &mut dyn FnMut(&AllocMsg)) {
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
