//! One process, one thread: messages stay where they are written, nobody is woken.

use heapless::Deque;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use super::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameRx, FrameTx, LinkError, StatRx,
    StatTx, Wake,
};
use crate::limits;
use crate::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};

/// Actions that wait for the world; the oldest gives way.
const ACTIONS: usize = 2 * limits::AGENTS;
/// Statuses that wait for the world; the oldest gives way.
const STATUSES: usize = 8;

/// 64 bytes of memory for frames, aligned as they need it.
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct FrameBlock([u8; 64]);

impl FrameBlock {
    /// Zeros.
    pub fn zeroed() -> Self {
        Self::new_zeroed()
    }
}

/// The messages of a team that runs in one thread. Each role borrows it in turn.
pub struct Direct<'b> {
    clock: &'b dyn Clock,
    header: FrameHeader,
    payload: &'b mut [u8],
    frames: u64,
    allocation: Option<AllocMsg>,
    allocations: u64,
    actions: Deque<ActionMsg, ACTIONS>,
    statuses: Deque<StatMsg, STATUSES>,
}

/// What one reader of a [`Direct`] has seen.
#[derive(Clone, Copy, Debug, Default)]
pub struct DirectCursor {
    frames: u64,
    kept: bool,
    allocations: u64,
}

impl<'b> Direct<'b> {
    /// `memory` holds the newest frame: as many bytes as the domain's layout says.
    pub fn new(memory: &'b mut [FrameBlock], clock: &'b dyn Clock) -> Self {
        Self {
            clock,
            header: FrameHeader::default(),
            payload: memory.as_mut_bytes(),
            frames: 0,
            allocation: None,
            allocations: 0,
            actions: Deque::new(),
            statuses: Deque::new(),
        }
    }

    /// The world's end.
    pub fn world<'a>(&'a mut self, cursor: &'a mut DirectCursor) -> DirectWorld<'a, 'b> {
        DirectWorld { team: self, cursor }
    }

    /// A runner's end.
    pub fn agent<'a>(&'a mut self, cursor: &'a mut DirectCursor) -> DirectAgent<'a, 'b> {
        DirectAgent { team: self, cursor }
    }

    /// The allocator's end.
    pub fn allocator<'a>(&'a mut self, cursor: &'a mut DirectCursor) -> DirectAllocator<'a, 'b> {
        DirectAllocator { team: self, cursor }
    }

    fn frame(&self) -> Frame<'_> {
        Frame { header: &self.header, payload: self.payload }
    }

    fn allocation_after(&self, cursor: &mut DirectCursor) -> Option<&AllocMsg> {
        let seen = core::mem::replace(&mut cursor.allocations, self.allocations);
        self.allocation.as_ref().filter(|_| seen < self.allocations)
    }
}

/// The world's end of a [`Direct`].
pub struct DirectWorld<'a, 'b> {
    team: &'a mut Direct<'b>,
    cursor: &'a mut DirectCursor,
}

/// A runner's end of a [`Direct`].
pub struct DirectAgent<'a, 'b> {
    team: &'a mut Direct<'b>,
    cursor: &'a mut DirectCursor,
}

/// The allocator's end of a [`Direct`].
pub struct DirectAllocator<'a, 'b> {
    team: &'a mut Direct<'b>,
    cursor: &'a mut DirectCursor,
}

/// Adds `message`; the oldest gives way to it.
fn push<T, const N: usize>(queue: &mut Deque<T, N>, message: T) {
    if queue.is_full() {
        queue.pop_front();
    }
    // There is room: one was taken out above.
    let _ = queue.push_back(message);
}

impl FrameTx for DirectWorld<'_, '_> {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        self.team.header = fill(self.team.payload)?;
        self.team.frames += 1;
        Ok(())
    }
}

impl ActionRx for DirectWorld<'_, '_> {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        while let Some(action) = self.team.actions.pop_front() {
            take(&action);
        }
        Ok(())
    }
}

impl StatRx for DirectWorld<'_, '_> {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        while let Some(status) = self.team.statuses.pop_front() {
            take(&status);
        }
        Ok(())
    }
}

impl ActionTx for DirectAgent<'_, '_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        push(&mut self.team.actions, *action);
        Ok(())
    }
}

impl AllocTx for DirectAllocator<'_, '_> {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        self.team.allocation = Some(*allocation);
        self.team.allocations += 1;
        Ok(())
    }
}

impl StatTx for DirectWorld<'_, '_> {
    /// Nobody of the team reads what its world tells of itself.
    fn send_status(&mut self, _status: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

macro_rules! receives_frames {
    ($($end:ident),+) => {$(
        impl FrameRx for $end<'_, '_> {
            fn receive_frames(
                &mut self,
                accept: &mut dyn FnMut(Frame<'_>) -> bool,
            ) -> Result<bool, LinkError> {
                if self.cursor.frames == self.team.frames {
                    return Ok(false);
                }
                self.cursor.frames = self.team.frames;
                self.cursor.kept = accept(self.team.frame());
                Ok(self.cursor.kept)
            }

            fn frame(&self) -> Option<Frame<'_>> {
                let newest = self.cursor.kept && self.cursor.frames == self.team.frames;
                newest.then(|| self.team.frame())
            }
        }
    )+};
}
receives_frames!(DirectAgent, DirectAllocator);

macro_rules! receives_allocations {
    ($($end:ident),+) => {$(
        impl AllocRx for $end<'_, '_> {
            fn receive_allocations(
                &mut self,
                take: &mut dyn FnMut(&AllocMsg),
            ) -> Result<(), LinkError> {
                if let Some(allocation) = self.team.allocation_after(self.cursor) {
                    take(allocation);
                }
                Ok(())
            }
        }
    )+};
}
receives_allocations!(DirectAgent, DirectWorld);

macro_rules! sends_statuses {
    ($($end:ident),+) => {$(
        impl StatTx for $end<'_, '_> {
            fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
                push(&mut self.team.statuses, *status);
                Ok(())
            }
        }
    )+};
}
sends_statuses!(DirectAgent, DirectAllocator);

macro_rules! shares_a_thread {
    ($($end:ident),+) => {$(
        impl Bell for $end<'_, '_> {
            fn token(&self) -> u32 {
                0
            }

            /// Nobody else runs while this thread waits, so it does not.
            fn wait_until(&mut self, _token: u32, _until_ns: u64) -> Wake {
                Wake::Timeout
            }

            fn ring(&mut self, _role: Role) -> Result<(), LinkError> {
                Ok(())
            }
        }

        impl Clock for $end<'_, '_> {
            fn now_ns(&self) -> u64 {
                self.team.clock.now_ns()
            }
        }
    )+};
}
shares_a_thread!(DirectWorld, DirectAgent, DirectAllocator);
