//! A team on one chip: on two cores, or in a loop and its interrupts.
//!
//! The messages lie in memory that [`Spsc`] owns, in two slots for every writer: one holds the newest
//! message while the other is written. There is one writer to a topic, readers only read, and
//! all that is asked of the processor are loads and stores of 32 bits. Nothing here locks, waits
//! (but for [`Bell::wait_until`]), allocates or panics, and a reader that is slow gets the newest
//! message whole.

mod ends;
mod memory;
mod topic;

mod atomic {
    pub(super) use core::sync::atomic::{AtomicU32, Ordering, fence};
}

use self::atomic::AtomicU32;
use self::ends::{AllocatorWriter, FrameReader, RunnerWriter, Shared};
pub use self::ends::{SpscAgent, SpscAllocator, SpscWorld};
use self::memory::{
    AllocatorCursors, AllocatorTopics, FrameReaderMemory, HEADER, Rings, RunnerCursors,
    RunnerTopics, TopicMemory, no_rings,
};
use self::topic::Writer;
use super::{Clock, LinkError};
use crate::plan::Aligned;
use crate::shape::Shape;
use crate::wire::{FrameError, FrameLayout, payload_bytes};

#[cfg(doc)]
use super::Bell;

/// The processor: its clock, and how a core waits.
pub trait Processor: Clock + Sync {
    /// Waits for an event, on Cortex-M by `wfe`; may return at any time.
    fn rest(&self) {
        core::hint::spin_loop();
    }

    /// Causes an event on the other cores, on Cortex-M by `sev`.
    fn wake(&self) {}
}

/// `FRAME` of a [`Spsc`] whose frames have this shape: the words of header and payload.
pub const fn frame_words(shape: Shape) -> usize {
    HEADER + payload_bytes(shape) / size_of::<u32>()
}

/// The memory of a team on one chip: a `static`, or a local that outlives the team.
///
/// `FRAME` is [`frame_words`] of the team's shape. Of a runner, up to 15 actions wait for the world.
pub struct Spsc<const FRAME: usize, const RUNNERS: usize, const ALLOCATORS: usize> {
    frames: TopicMemory<FRAME, 2>,
    world_rings: Rings,
    runners: [RunnerTopics; RUNNERS],
    allocators: [AllocatorTopics; ALLOCATORS],
    world: WorldMemory<FRAME, RUNNERS, ALLOCATORS>,
    agents: [(FrameReaderMemory<FRAME>, [AllocatorCursors; ALLOCATORS]); RUNNERS],
    allocating: [FrameReaderMemory<FRAME>; ALLOCATORS],
}

/// What only the world uses.
struct WorldMemory<const FRAME: usize, const RUNNERS: usize, const ALLOCATORS: usize> {
    frame: Aligned<[u32; FRAME]>,
    runners: [RunnerCursors; RUNNERS],
    allocators: [AllocatorCursors; ALLOCATORS],
}

/// The ends of a team; each goes to the core that uses it.
pub struct SpscEnds<'a, const RUNNERS: usize, const ALLOCATORS: usize> {
    /// The world's.
    pub world: SpscWorld<'a>,
    /// The runners'.
    pub agents: [SpscAgent<'a>; RUNNERS],
    /// The allocators'.
    pub allocators: [SpscAllocator<'a>; ALLOCATORS],
}

impl<const FRAME: usize, const RUNNERS: usize, const ALLOCATORS: usize>
    Spsc<FRAME, RUNNERS, ALLOCATORS>
{
    /// Nothing sent yet.
    pub const fn new() -> Self {
        Self {
            frames: TopicMemory::new(),
            world_rings: no_rings(),
            runners: [const { RunnerTopics::new() }; RUNNERS],
            allocators: [const { AllocatorTopics::new() }; ALLOCATORS],
            world: WorldMemory {
                frame: Aligned([0; FRAME]),
                runners: [RunnerCursors::START; RUNNERS],
                allocators: [AllocatorCursors::START; ALLOCATORS],
            },
            agents: [const { (FrameReaderMemory::new(), [AllocatorCursors::START; ALLOCATORS]) };
                RUNNERS],
            allocating: [const { FrameReaderMemory::new() }; ALLOCATORS],
        }
    }

    /// Hands out the ends, once.
    ///
    /// # Errors
    /// [`FrameError::Length`]: `FRAME` is not what the layout needs.
    pub fn split<'a>(
        &'a mut self,
        layout: &FrameLayout,
        processor: &'a dyn Processor,
    ) -> Result<SpscEnds<'a, RUNNERS, ALLOCATORS>, LinkError> {
        if FRAME != frame_words(layout.shape()) {
            return Err(LinkError::Frame(FrameError::Length));
        }
        let shared = Shared {
            frames: self.frames.topic(),
            world_rings: &self.world_rings,
            runners: &self.runners,
            allocators: &self.allocators,
            processor,
        };
        let WorldMemory { frame, runners, allocators } = &mut self.world;
        let world = SpscWorld {
            shared,
            frames: Writer::new(shared.frames),
            frame: &mut frame.0,
            runners,
            allocators,
        };
        let mut topics = self.runners.iter();
        let agents = self.agents.each_mut().map(|(memory, allocators)| SpscAgent {
            shared,
            frames: FrameReader::new(memory),
            allocators,
            mine: topics.next().map(RunnerWriter::new),
        });
        let mut topics = self.allocators.iter();
        let allocators = self.allocating.each_mut().map(|memory| SpscAllocator {
            shared,
            frames: FrameReader::new(memory),
            mine: topics.next().map(AllocatorWriter::new),
        });
        Ok(SpscEnds { world, agents, allocators })
    }
}

impl<const FRAME: usize, const RUNNERS: usize, const ALLOCATORS: usize> Default
    for Spsc<FRAME, RUNNERS, ALLOCATORS>
{
    fn default() -> Self {
        Self::new()
    }
}

/// Counts one more ring. For the only one that rings by it.
fn raise(rings: &AtomicU32) {
    let rung = rings.load(atomic::Ordering::Relaxed).wrapping_add(1);
    rings.store(rung, atomic::Ordering::Release);
}
