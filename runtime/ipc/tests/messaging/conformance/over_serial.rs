//! Runners at the other end of serial lines; world and allocators share a thread.

use std::borrow::BorrowMut;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use sortie_core::link::{
    Clock, Direct, DirectAllocator, DirectCursor, DirectWorld, FrameBlock, Processor, Relay,
    Serial, packet_bytes,
};
use sortie_core::wire::FrameFormat;
use sortie_ipc::MonotonicClock;

use super::{Transport, format_of};
use crate::toy;

/// Lets other threads run where a board would sleep.
struct Host;

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

type Bytes = Rc<RefCell<VecDeque<u8>>>;

/// One end of a line.
#[derive(Clone, Default)]
pub(super) struct Wire {
    comes: Bytes,
    goes: Bytes,
}

impl Wire {
    fn other_end(&self) -> Self {
        Self { comes: Rc::clone(&self.goes), goes: Rc::clone(&self.comes) }
    }
}

impl ErrorType for Wire {
    type Error = Infallible;
}

impl Read for Wire {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let mut comes = RefCell::borrow_mut(&self.comes);
        let len = comes.len().min(bytes.len());
        bytes.iter_mut().zip(comes.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl ReadReady for Wire {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!RefCell::borrow(&self.comes).is_empty())
    }
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        RefCell::borrow_mut(&self.goes).extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

struct Remote {
    agent: Serial<'static, Wire>,
    relay: Relay<'static, Wire>,
    cursor: DirectCursor,
}

impl Remote {
    fn new(format: FrameFormat) -> Self {
        let wire = Wire::default();
        let packet = || vec![0; packet_bytes(toy::SHAPE)].leak();
        let memory = vec![FrameBlock::zeroed(); FrameBlock::for_serial(toy::SHAPE)].leak();
        let relay = Relay::new(wire.other_end(), format, u64::MAX, packet());
        let agent = Serial::new(wire, &Host, format, memory, packet()).unwrap();
        Self { agent, relay, cursor: DirectCursor::default() }
    }
}

pub(super) struct OverSerial {
    team: Direct<'static>,
    format: FrameFormat,
    world: DirectCursor,
    remotes: [Remote; 3],
    allocators: [DirectCursor; 2],
}

impl OverSerial {
    /// The relays are always at work.
    fn relay(&mut self) {
        for remote in &mut self.remotes {
            remote.relay.turn(&mut self.team.agent(&mut remote.cursor)).unwrap();
        }
    }
}

impl Transport for OverSerial {
    type WorldLink<'a> = DirectWorld<'a, 'static>;
    type AgentLink<'a> = Serial<'static, Wire>;
    type AllocLink<'a> = DirectAllocator<'a, 'static>;

    fn new() -> Self {
        let format = format_of(&toy::contract());
        let memory = vec![FrameBlock::zeroed(); format.layout.payload_bytes() / 64].leak();
        Self {
            team: Direct::new(memory, &MonotonicClock),
            format,
            world: DirectCursor::default(),
            remotes: [(); 3].map(|()| Remote::new(format)),
            allocators: [DirectCursor::default(); 2],
        }
    }

    fn format(&self) -> FrameFormat {
        self.format
    }

    fn world(&mut self) -> impl BorrowMut<Self::WorldLink<'_>> {
        self.relay();
        self.team.world(&mut self.world)
    }

    fn agent(&mut self, index: usize) -> impl BorrowMut<Self::AgentLink<'_>> {
        self.relay();
        &mut self.remotes[index].agent
    }

    fn allocator(&mut self, index: usize) -> impl BorrowMut<Self::AllocLink<'_>> {
        self.relay();
        self.team.allocator(&mut self.allocators[index])
    }

    fn housekeep(&mut self) {}
}
