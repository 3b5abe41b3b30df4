//! The ends of a team on one chip.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::atomic::Ordering;
use super::memory::{
    AllocatorCursors, AllocatorTopics, FrameReaderMemory, HEADER, Rings, RunnerCursors,
    RunnerTopics,
};
use super::topic::{Cursor, Topic, Writer};
use super::{Processor, raise};
use crate::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameRx, FrameTx, LinkError, StatRx,
    StatTx, Wake,
};
use crate::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};

/// What all ends see.
#[derive(Clone, Copy)]
pub(super) struct Shared<'a> {
    pub(super) frames: Topic<'a>,
    pub(super) world_rings: &'a Rings,
    pub(super) runners: &'a [RunnerTopics],
    pub(super) allocators: &'a [AllocatorTopics],
    pub(super) processor: &'a dyn Processor,
}

impl Shared<'_> {
    /// How often anybody rang `role`.
    fn rung(&self, role: Role) -> u32 {
        let runners = self.runners.iter().map(|runner| &runner.rings);
        let allocators = self.allocators.iter().map(|allocator| &allocator.rings);
        core::iter::once(self.world_rings)
            .chain(runners)
            .chain(allocators)
            .filter_map(|rings| rings.get(role as usize))
            .fold(0, |sum, rings| sum.wrapping_add(rings.load(Ordering::Acquire)))
    }

    fn wait_until(&self, role: Role, token: u32, until_ns: u64) -> Wake {
        while self.rung(role) == token {
            if self.processor.now_ns() >= until_ns {
                return Wake::Timeout;
            }
            self.processor.rest();
        }
        Wake::Rung
    }

    fn receive_allocations(
        &self,
        cursors: &mut [AllocatorCursors],
        take: &mut dyn FnMut(&AllocMsg),
    ) {
        for (allocator, seen) in self.allocators.iter().zip(cursors) {
            receive(allocator.allocations.topic(), &mut seen.allocations, take);
        }
    }
}

/// The world's end of a [`Spsc`](super::Spsc).
pub struct SpscWorld<'a> {
    pub(super) shared: Shared<'a>,
    pub(super) frames: Writer<'a>,
    pub(super) frame: &'a mut [u32],
    pub(super) runners: &'a mut [RunnerCursors],
    pub(super) allocators: &'a mut [AllocatorCursors],
}

/// A runner's end of a [`Spsc`](super::Spsc).
pub struct SpscAgent<'a> {
    pub(super) shared: Shared<'a>,
    pub(super) frames: FrameReader<'a>,
    pub(super) allocators: &'a mut [AllocatorCursors],
    pub(super) mine: Option<RunnerWriter<'a>>,
}

/// An allocator's end of a [`Spsc`](super::Spsc).
pub struct SpscAllocator<'a> {
    pub(super) shared: Shared<'a>,
    pub(super) frames: FrameReader<'a>,
    pub(super) mine: Option<AllocatorWriter<'a>>,
}

/// Writes what only one runner writes.
pub(super) struct RunnerWriter<'a> {
    actions: Writer<'a>,
    statuses: Writer<'a>,
    rings: &'a Rings,
}

impl<'a> RunnerWriter<'a> {
    pub(super) fn new(topics: &'a RunnerTopics) -> Self {
        Self {
            actions: Writer::new(topics.actions.topic()),
            statuses: Writer::new(topics.statuses.topic()),
            rings: &topics.rings,
        }
    }
}

/// Writes what only one allocator writes.
pub(super) struct AllocatorWriter<'a> {
    allocations: Writer<'a>,
    statuses: Writer<'a>,
    rings: &'a Rings,
}

impl<'a> AllocatorWriter<'a> {
    pub(super) fn new(topics: &'a AllocatorTopics) -> Self {
        Self {
            allocations: Writer::new(topics.allocations.topic()),
            statuses: Writer::new(topics.statuses.topic()),
            rings: &topics.rings,
        }
    }
}

impl SpscWorld<'_> {
    /// Actions that gave way to newer ones before the world looked at them.
    pub fn missed_actions(&self) -> u32 {
        self.runners.iter().fold(0, |sum, seen| sum.saturating_add(seen.actions.missed))
    }
}

/// Reads frames, and keeps one while the next is looked at.
pub(super) struct FrameReader<'a> {
    cursor: Cursor,
    kept: &'a mut [u32],
    spare: &'a mut [u32],
    is_kept: bool,
}

impl<'a> FrameReader<'a> {
    pub(super) fn new<const FRAME: usize>(memory: &'a mut FrameReaderMemory<FRAME>) -> Self {
        let (kept, spare) = (&mut memory.kept.0[..], &mut memory.spare.0[..]);
        Self { cursor: Cursor::default(), kept, spare, is_kept: false }
    }

    fn receive(&mut self, topic: Topic<'_>, accept: &mut dyn FnMut(Frame<'_>) -> bool) -> bool {
        let is_accepted =
            topic.next(&mut self.cursor, self.spare) && frame(self.spare).is_some_and(accept);
        if is_accepted {
            core::mem::swap(&mut self.kept, &mut self.spare);
            self.is_kept = true;
        }
        is_accepted
    }

    fn kept(&self) -> Option<Frame<'_>> {
        if self.is_kept { frame(self.kept) } else { None }
    }
}

fn frame(words: &[u32]) -> Option<Frame<'_>> {
    let (header, payload) = words.split_at_checked(HEADER)?;
    let header = FrameHeader::ref_from_bytes(header.as_bytes()).ok()?;
    Some(Frame { header, payload: payload.as_bytes() })
}

/// Shows every waiting message of one writer to `take`.
fn receive<M>(topic: Topic<'_>, cursor: &mut Cursor, take: &mut dyn FnMut(&M))
where
    M: FromBytes + IntoBytes + Immutable + KnownLayout,
{
    let mut message = M::new_zeroed();
    // A writer that never rests does not keep the reader here for ever.
    for _ in 0..topic.numbers.len() {
        let Ok(words) = <[u32]>::mut_from_bytes(message.as_mut_bytes()) else { return };
        if !topic.next(cursor, words) {
            return;
        }
        take(&message);
    }
}

fn put<M: IntoBytes + Immutable>(writer: &mut Writer<'_>, message: &M) {
    if let Ok(words) = <[u32]>::ref_from_bytes(message.as_bytes()) {
        writer.put(words);
    }
}

impl FrameTx for SpscWorld<'_> {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        let halves = self.frame.split_at_mut_checked(HEADER);
        let (header, payload) = halves.ok_or(LinkError::Frames)?;
        let filled = fill(payload.as_mut_bytes())?;
        filled.write_to(header.as_mut_bytes()).map_err(|_| LinkError::Frames)?;
        self.frames.put(self.frame);
        Ok(())
    }
}

impl ActionRx for SpscWorld<'_> {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        for (runner, seen) in self.shared.runners.iter().zip(self.runners.iter_mut()) {
            receive(runner.actions.topic(), &mut seen.actions, take);
        }
        Ok(())
    }
}

impl StatRx for SpscWorld<'_> {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        for (runner, seen) in self.shared.runners.iter().zip(self.runners.iter_mut()) {
            receive(runner.statuses.topic(), &mut seen.statuses, take);
        }
        for (allocator, seen) in self.shared.allocators.iter().zip(self.allocators.iter_mut()) {
            receive(allocator.statuses.topic(), &mut seen.statuses, take);
        }
        Ok(())
    }
}

impl StatTx for SpscWorld<'_> {
    /// Nobody of the team reads what its world tells of itself.
    fn send_status(&mut self, _status: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

impl ActionTx for SpscAgent<'_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        put(&mut self.mine.as_mut().ok_or(LinkError::Actions)?.actions, action);
        Ok(())
    }
}

impl AllocTx for SpscAllocator<'_> {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        put(&mut self.mine.as_mut().ok_or(LinkError::Allocations)?.allocations, allocation);
        Ok(())
    }
}

macro_rules! reads_frames_and_tells_status {
    ($($end:ident),+) => {$(
        impl FrameRx for $end<'_> {
            fn receive_frames(
                &mut self,
                accept: &mut dyn FnMut(Frame<'_>) -> bool,
            ) -> Result<bool, LinkError> {
                Ok(self.frames.receive(self.shared.frames, accept))
            }

            fn frame(&self) -> Option<Frame<'_>> {
                self.frames.kept()
            }
        }

        impl StatTx for $end<'_> {
            fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
                put(&mut self.mine.as_mut().ok_or(LinkError::Statuses)?.statuses, status);
                Ok(())
            }
        }
    )+};
}
reads_frames_and_tells_status!(SpscAgent, SpscAllocator);

macro_rules! receives_allocations {
    ($($end:ident),+) => {$(
        impl AllocRx for $end<'_> {
            fn receive_allocations(
                &mut self,
                take: &mut dyn FnMut(&AllocMsg),
            ) -> Result<(), LinkError> {
                self.shared.receive_allocations(self.allocators, take);
                Ok(())
            }
        }
    )+};
}
receives_allocations!(SpscAgent, SpscWorld);

impl<'a> SpscWorld<'a> {
    fn rings(&self) -> Option<&'a Rings> {
        Some(self.shared.world_rings)
    }
}

impl<'a> SpscAgent<'a> {
    fn rings(&self) -> Option<&'a Rings> {
        self.mine.as_ref().map(|mine| mine.rings)
    }
}

impl<'a> SpscAllocator<'a> {
    fn rings(&self) -> Option<&'a Rings> {
        self.mine.as_ref().map(|mine| mine.rings)
    }
}

macro_rules! rings_and_waits {
    ($($end:ident: $role:ident),+) => {$(
        impl Bell for $end<'_> {
            fn token(&self) -> u32 {
                self.shared.rung(Role::$role)
            }

            fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
                self.shared.wait_until(Role::$role, token, until_ns)
            }

            fn ring(&mut self, role: Role) -> Result<(), LinkError> {
                let rings = self.rings().and_then(|rings| rings.get(role as usize));
                raise(rings.ok_or(LinkError::Bell)?);
                self.shared.processor.wake();
                Ok(())
            }
        }

        impl Clock for $end<'_> {
            fn now_ns(&self) -> u64 {
                self.shared.processor.now_ns()
            }
        }
    )+};
}
rings_and_waits!(SpscWorld: World, SpscAgent: Runner, SpscAllocator: Allocator);
