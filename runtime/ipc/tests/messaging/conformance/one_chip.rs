//! A team in memory that two cores share.

use std::borrow::BorrowMut;

use sortie_core::link::{
    Clock, Processor, Spsc, SpscAgent, SpscAllocator, SpscEnds, SpscWorld, frame_words,
};
use sortie_core::wire::FrameFormat;
use sortie_ipc::MonotonicClock;

use super::{Transport, format_of};
use crate::toy;

/// Lets other threads run where a core would sleep.
pub(crate) struct Host;

impl Clock for Host {
    fn now_ns(&self) -> u64 {
        MonotonicClock.now_ns()
    }
}

impl Processor for Host {
    fn rest(&self) {
        std::thread::yield_now();
    }
}

pub(crate) type ToySpsc = Spsc<{ frame_words(toy::SHAPE) }, 3, 2>;

pub(super) struct OneChip {
    ends: SpscEnds<'static, 3, 2>,
    format: FrameFormat,
}

impl Transport for OneChip {
    type WorldLink<'a> = SpscWorld<'static>;
    type AgentLink<'a> = SpscAgent<'static>;
    type AllocLink<'a> = SpscAllocator<'static>;

    fn new() -> Self {
        let format = format_of(&toy::contract());
        let memory = Box::leak(Box::new(ToySpsc::new()));
        Self { ends: memory.split(&format.layout, &Host).unwrap(), format }
    }

    fn format(&self) -> FrameFormat {
        self.format
    }

    fn world(&mut self) -> impl BorrowMut<Self::WorldLink<'_>> {
        &mut self.ends.world
    }

    fn agent(&mut self, index: usize) -> impl BorrowMut<Self::AgentLink<'_>> {
        &mut self.ends.agents[index]
    }

    fn allocator(&mut self, index: usize) -> impl BorrowMut<Self::AllocLink<'_>> {
        &mut self.ends.allocators[index]
    }

    fn housekeep(&mut self) {}
}
