//! The memory of a team on one chip.

use super::atomic::AtomicU32;
use super::topic::{Cursor, Topic};
use crate::plan::Aligned;
use crate::wire::{ActionMsg, AllocMsg, FrameHeader, StatMsg};

/// Words of a message.
pub(super) const fn words<M>() -> usize {
    size_of::<M>() / size_of::<u32>()
}

/// Words of a frame's header.
pub(super) const HEADER: usize = words::<FrameHeader>();
/// Actions of one runner that wait for the world, and one that is being written.
const ACTIONS: usize = 16;

pub(super) struct TopicMemory<const WORDS: usize, const SLOTS: usize> {
    newest: AtomicU32,
    numbers: [AtomicU32; SLOTS],
    words: [[AtomicU32; WORDS]; SLOTS],
}

impl<const WORDS: usize, const SLOTS: usize> TopicMemory<WORDS, SLOTS> {
    pub(super) const fn new() -> Self {
        const { assert!(SLOTS.is_power_of_two() && SLOTS > 1) };
        Self {
            newest: AtomicU32::new(0),
            numbers: [const { AtomicU32::new(0) }; SLOTS],
            words: [const { [const { AtomicU32::new(0) }; WORDS] }; SLOTS],
        }
    }

    pub(super) fn topic(&self) -> Topic<'_> {
        Topic { newest: &self.newest, numbers: &self.numbers, words: self.words.as_flattened() }
    }
}

/// How often somebody rang world, runners and allocators.
pub(super) type Rings = [AtomicU32; 3];

pub(super) const fn no_rings() -> Rings {
    [const { AtomicU32::new(0) }; 3]
}

/// What one runner writes.
pub(super) struct RunnerTopics {
    pub(super) actions: TopicMemory<{ words::<ActionMsg>() }, ACTIONS>,
    pub(super) statuses: TopicMemory<{ words::<StatMsg>() }, 2>,
    pub(super) rings: Rings,
}

impl RunnerTopics {
    pub(super) const fn new() -> Self {
        Self { actions: TopicMemory::new(), statuses: TopicMemory::new(), rings: no_rings() }
    }
}

/// What one allocator writes.
pub(super) struct AllocatorTopics {
    pub(super) allocations: TopicMemory<{ words::<AllocMsg>() }, 2>,
    pub(super) statuses: TopicMemory<{ words::<StatMsg>() }, 2>,
    pub(super) rings: Rings,
}

impl AllocatorTopics {
    pub(super) const fn new() -> Self {
        Self { allocations: TopicMemory::new(), statuses: TopicMemory::new(), rings: no_rings() }
    }
}

/// What the world has seen of one runner.
#[derive(Clone, Copy)]
pub(super) struct RunnerCursors {
    pub(super) actions: Cursor,
    pub(super) statuses: Cursor,
}

/// What somebody has seen of one allocator.
#[derive(Clone, Copy)]
pub(super) struct AllocatorCursors {
    pub(super) allocations: Cursor,
    pub(super) statuses: Cursor,
}

impl Cursor {
    pub(super) const START: Self = Self { number: 0, missed: 0 };
}

impl RunnerCursors {
    pub(super) const START: Self = Self { actions: Cursor::START, statuses: Cursor::START };
}

impl AllocatorCursors {
    pub(super) const START: Self = Self { allocations: Cursor::START, statuses: Cursor::START };
}

/// Memory that only one reader of frames uses: the frame kept, and room for the next.
pub(super) struct FrameReaderMemory<const FRAME: usize> {
    pub(super) kept: Aligned<[u32; FRAME]>,
    pub(super) spare: Aligned<[u32; FRAME]>,
}

impl<const FRAME: usize> FrameReaderMemory<FRAME> {
    pub(super) const fn new() -> Self {
        Self { kept: Aligned([0; FRAME]), spare: Aligned([0; FRAME]) }
    }
}
