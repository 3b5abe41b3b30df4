//! The links of world, runner and allocator.

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameRx, FrameTx, LinkError, StatRx,
    StatTx, Wake,
};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameFormat, FrameHeader, Role, StatMsg};

use super::bell::EventBell;
use super::message::{ActionPayload, AllocPayload, FrameHeaderPayload, Message, StatPayload};
use super::open::{FrameReceiver, FrameSender, Opener, Receiver, Sender};
use super::services;
use crate::clock::MonotonicClock;
use crate::domain::Domain;
use crate::error::Error;

/// What a link is opened with.
#[derive(Clone, Copy, Debug)]
pub struct LinkSetup<'a> {
    /// The domain, which this process has entered.
    pub domain: &'a Domain,
    /// Its frames.
    pub format: FrameFormat,
    /// Name of the process's node and ports.
    pub name: &'a str,
}

/// The world's link over shared memory.
pub struct IoxWorld {
    frames: FrameSender,
    payload_bytes: usize,
    actions: Receiver<ActionPayload>,
    allocations: Receiver<AllocPayload>,
    statuses: Receiver<StatPayload>,
    bell: EventBell,
    /// Dropped last.
    _node: Node<ipc::Service>,
}

/// A runner's link over shared memory.
pub struct IoxAgent {
    frames: FrameReader,
    allocations: Receiver<AllocPayload>,
    actions: Sender<ActionPayload>,
    statuses: Sender<StatPayload>,
    bell: EventBell,
    /// Dropped last.
    _node: Node<ipc::Service>,
}

/// The allocator's link over shared memory.
pub struct IoxAllocator {
    frames: FrameReader,
    allocations: Sender<AllocPayload>,
    statuses: Sender<StatPayload>,
    bell: EventBell,
    /// Dropped last.
    _node: Node<ipc::Service>,
}

impl IoxWorld {
    /// Opens the world's topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            actions: opener.receiver(services::actions)?,
            allocations: opener.receiver(services::allocations)?,
            statuses: opener.receiver(services::statuses)?,
            frames: opener.frame_sender()?,
            payload_bytes: setup.format.layout.payload_bytes(),
            bell: EventBell::new(&opener, Role::World, &[Role::Runner, Role::Allocator])?,
            _node: opener.into_node(),
        })
    }
}

impl IoxAgent {
    /// Opens a runner's topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            frames: FrameReader::new(opener.frame_receiver()?),
            allocations: opener.receiver(services::allocations)?,
            actions: opener.sender(services::actions)?,
            statuses: opener.sender(services::statuses)?,
            bell: EventBell::new(&opener, Role::Runner, &[Role::World])?,
            _node: opener.into_node(),
        })
    }
}

impl IoxAllocator {
    /// Opens the allocator's topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            frames: FrameReader::new(opener.frame_receiver()?),
            allocations: opener.sender(services::allocations)?,
            statuses: opener.sender(services::statuses)?,
            bell: EventBell::new(&opener, Role::Allocator, &[Role::World, Role::Runner])?,
            _node: opener.into_node(),
        })
    }
}

/// What is due once per heartbeat, never between a frame and its action.
pub trait Housekeeping {
    /// Connects to new subscribers and hands them the history: publishers do this only when they
    /// send, or here.
    fn housekeep(&mut self);
}

impl Housekeeping for IoxWorld {
    fn housekeep(&mut self) {
        // A connection that fails is tried again at the next heartbeat.
        let _ = self.frames.update_connections();
    }
}

impl Housekeeping for IoxAgent {
    fn housekeep(&mut self) {
        let _ = self.actions.update_connections();
        let _ = self.statuses.update_connections();
    }
}

impl Housekeeping for IoxAllocator {
    fn housekeep(&mut self) {
        let _ = self.allocations.update_connections();
        let _ = self.statuses.update_connections();
    }
}

/// Keeps the frame that was accepted last.
struct FrameReader {
    receiver: FrameReceiver,
    kept: Option<Sample<ipc::Service, [u8], FrameHeaderPayload>>,
}

impl FrameReader {
    fn new(receiver: FrameReceiver) -> Self {
        Self { receiver, kept: None }
    }

    fn receive(&mut self, accept: &mut dyn FnMut(Frame<'_>) -> bool) -> Result<bool, LinkError> {
        let mut accepted = false;
        while let Some(sample) = self.receiver.receive().map_err(|_| LinkError::Frames)? {
            let frame = Frame { header: sample.user_header().message(), payload: sample.payload() };
            if accept(frame) {
                self.kept = Some(sample);
                accepted = true;
            }
        }
        Ok(accepted)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        let sample = self.kept.as_ref()?;
        Some(Frame { header: sample.user_header().message(), payload: sample.payload() })
    }
}

fn drain<M: Message>(
    receiver: &Receiver<M>,
    failure: LinkError,
    take: &mut dyn FnMut(&M::Wire),
) -> Result<(), LinkError> {
    while let Some(sample) = receiver.receive().map_err(|_| failure)? {
        take(sample.payload().message());
    }
    Ok(())
}

fn send<M: Message>(
    sender: &Sender<M>,
    failure: LinkError,
    message: &M::Wire,
) -> Result<(), LinkError> {
    sender.send_copy(M::wrap(message)).map(|_| ()).map_err(|_| failure)
}

impl FrameTx for IoxWorld {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        let mut sample =
            self.frames.loan_slice(self.payload_bytes).map_err(|_| LinkError::Frames)?;
        let header = fill(sample.payload_mut())?;
        *sample.user_header_mut() = FrameHeaderPayload::wrap(&header);
        sample.send().map(|_| ()).map_err(|_| LinkError::Frames)
    }
}

impl ActionRx for IoxWorld {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        drain(&self.actions, LinkError::Actions, take)
    }
}

impl AllocRx for IoxWorld {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        drain(&self.allocations, LinkError::Allocations, take)
    }
}

impl StatRx for IoxWorld {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        drain(&self.statuses, LinkError::Statuses, take)
    }
}

impl AllocRx for IoxAgent {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        drain(&self.allocations, LinkError::Allocations, take)
    }
}

impl ActionTx for IoxAgent {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        send(&self.actions, LinkError::Actions, action)
    }
}

impl AllocTx for IoxAllocator {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        send(&self.allocations, LinkError::Allocations, allocation)
    }
}

macro_rules! reads_frames_and_tells_status {
    ($($link:ident),+) => {$(
        impl FrameRx for $link {
            fn receive_frames(
                &mut self,
                accept: &mut dyn FnMut(Frame<'_>) -> bool,
            ) -> Result<bool, LinkError> {
                self.frames.receive(accept)
            }

            fn frame(&self) -> Option<Frame<'_>> {
                self.frames.frame()
            }
        }

        impl StatTx for $link {
            fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
                send(&self.statuses, LinkError::Statuses, status)
            }
        }
    )+};
}
reads_frames_and_tells_status!(IoxAgent, IoxAllocator);

macro_rules! has_bell_and_clock {
    ($($link:ident),+) => {$(
        impl Bell for $link {
            /// Rings wait in the listener until they are drained, so there is nothing to remember.
            fn token(&self) -> u32 {
                0
            }

            fn wait_until(&mut self, _token: u32, until_ns: u64) -> Wake {
                self.bell.wait_until(until_ns)
            }

            fn ring(&mut self, role: Role) -> Result<(), LinkError> {
                self.bell.ring(role)
            }
        }

        impl Clock for $link {
            fn now_ns(&self) -> u64 {
                MonotonicClock.now_ns()
            }
        }
    )+};
}
has_bell_and_clock!(IoxWorld, IoxAgent, IoxAllocator);
