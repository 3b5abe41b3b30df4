//! The links of world, runner and allocator.

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameRx, FrameTx, LinkError, StatRx,
    StatTx, Wake,
};
use sortie_core::wire::{
    ActionMsg, AllocMsg, Command, ControlRep, ControlReq, FrameHeader, Role, StatMsg,
};
use zerocopy::IntoBytes;

use super::bell::LinkBell;
use super::open::{PendingAnswers, Receiver, RequestClient, RequestServer, Sender, drain, send};
use super::opener::{FrameReceiver, Opener, WorldFrames};
use super::services::{
    self, ActionPayload, AllocPayload, Block, FrameHeaderPayload, LinkSetup, Message,
    RequestPayload, StatPayload,
};
use super::watcher::{ControlRx, serve};
use super::{InterProcess, LinkService};
use crate::error::Error;
use crate::stop::{MonotonicClock, Wakeable, Waker};

/// The world's link over shared memory.
pub struct IoxWorld<S: LinkService = InterProcess> {
    frames: WorldFrames<S>,
    actions: Receiver<S, ActionPayload>,
    allocations: Receiver<S, AllocPayload>,
    statuses: Receiver<S, StatPayload>,
    own_status: Sender<S, StatPayload>,
    requests: RequestServer<S>,
    control: RequestClient<S>,
    /// Answers to the last request to step down. Unread, they would keep the connections of the dead.
    answers: Option<PendingAnswers<S>>,
    schema: u64,
    bell: LinkBell<S>,
    /// Rings that end the next wait, if it knows.
    rings: Option<u32>,
    /// Dropped last.
    _node: Node<S>,
}

/// A runner's link over shared memory.
pub struct IoxAgent<S: LinkService = InterProcess> {
    frames: FrameReader<S>,
    allocations: Receiver<S, AllocPayload>,
    actions: Sender<S, ActionPayload>,
    statuses: Sender<S, StatPayload>,
    /// None for a runner inside another process, which answers for both.
    requests: Option<RequestServer<S>>,
    bell: LinkBell<S>,
    /// Rings that end the next wait, if it knows.
    rings: Option<u32>,
    /// Dropped last.
    _node: Node<S>,
}

/// The allocator's link over shared memory.
pub struct IoxAllocator<S: LinkService = InterProcess> {
    frames: FrameReader<S>,
    allocations: Sender<S, AllocPayload>,
    statuses: Sender<S, StatPayload>,
    requests: RequestServer<S>,
    bell: LinkBell<S>,
    /// Rings that end the next wait, if it knows.
    rings: Option<u32>,
    /// Dropped last.
    _node: Node<S>,
}

impl<S: LinkService> IoxWorld<S> {
    /// Opens the world's topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        Self::with_frames(setup, WorldFrames::shared)
    }

    /// The same for a domain whose frames are private: every agent gets its own, an allocator, if there is one,
    /// the world's.
    ///
    /// # Errors
    /// As [`Self::open`]; the domain has more entities than private frames have rows for.
    pub fn open_private(setup: &LinkSetup<'_>, has_allocator: bool) -> Result<Self, Error> {
        Self::with_frames(setup, |opener| WorldFrames::private(opener, has_allocator))
    }

    fn with_frames(
        setup: &LinkSetup<'_>,
        frames: impl FnOnce(&Opener<'_, S>) -> Result<WorldFrames<S>, Error>,
    ) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            actions: opener.receiver(services::actions)?,
            allocations: opener.receiver(services::allocations)?,
            statuses: opener.receiver(services::statuses)?,
            own_status: opener.sender(services::statuses)?,
            requests: opener.control_server()?,
            control: opener.control_client()?,
            answers: None,
            schema: setup.format.schema,
            frames: frames(&opener)?,
            bell: LinkBell::open(&opener, Role::World, &[Role::Runner, Role::Allocator])?,
            rings: None,
            _node: opener.into_node(),
        })
    }

    /// Asks the leading allocator to step down, and does not wait for its answer.
    ///
    /// # Errors
    /// It could not be woken.
    pub fn ask_to_step_down(&mut self, pid: u32) -> Result<(), LinkError> {
        let request = ControlReq { arg: pid, ..ControlReq::new(self.schema, Command::StepDown) };
        self.answers = None;
        // A request that is not sent is sent after the next three allocations missed.
        self.answers = self.control.send_copy(RequestPayload::wrap(&request)).ok();
        self.bell.ring(Role::Allocator)
    }
}

impl<S: LinkService> IoxAgent<S> {
    /// Opens a runner's topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        Self::with_frames_of(None, setup, true)
    }

    /// The same for a runner inside a process that answers requests itself.
    pub(crate) fn open_within(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        Self::with_frames_of(None, setup, false)
    }

    /// The link of a runner of `agent` alone, in a domain whose frames are private: it does not open the others'
    /// nor the world's. `setup` has the domain's format, the runner's role that of
    /// [`FrameLayout::private`](sortie_core::wire::FrameLayout::private).
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_private(setup: &LinkSetup<'_>, agent: usize) -> Result<Self, Error> {
        Self::with_frames_of(Some(agent), setup, true)
    }

    fn with_frames_of(
        agent: Option<usize>,
        setup: &LinkSetup<'_>,
        answers: bool,
    ) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            frames: FrameReader::new(opener.frame_receiver(agent)?),
            allocations: opener.receiver(services::allocations)?,
            actions: opener.sender(services::actions)?,
            statuses: opener.sender(services::statuses)?,
            requests: answers.then(|| opener.control_server()).transpose()?,
            bell: LinkBell::open(&opener, Role::Runner, &[Role::World])?,
            rings: None,
            _node: opener.into_node(),
        })
    }
}

impl<S: LinkService> IoxAllocator<S> {
    /// Opens the allocator's topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            frames: FrameReader::new(opener.frame_receiver(None)?),
            allocations: opener.sender(services::allocations)?,
            statuses: opener.sender(services::statuses)?,
            requests: opener.control_server()?,
            bell: LinkBell::open(&opener, Role::Allocator, &[Role::World, Role::Runner])?,
            rings: None,
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

impl<S: LinkService> Housekeeping for IoxWorld<S> {
    fn housekeep(&mut self) {
        self.frames.update_connections();
        // A connection that fails is tried again at the next heartbeat.
        let _ = self.own_status.update_connections();
        // Lets go of those that died, once they have nothing to say any more.
        let _ = self.control.update_connections();
        while let Some(answers) = &self.answers
            && let Ok(Some(_)) = answers.receive()
        {}
    }
}

impl<S: LinkService> Housekeeping for IoxAgent<S> {
    fn housekeep(&mut self) {
        let _ = self.actions.update_connections();
        let _ = self.statuses.update_connections();
    }
}

impl<S: LinkService> Housekeeping for IoxAllocator<S> {
    fn housekeep(&mut self) {
        let _ = self.allocations.update_connections();
        let _ = self.statuses.update_connections();
    }
}

type FrameSample<S> = Sample<S, [Block], FrameHeaderPayload>;

/// Keeps the frame that was accepted last.
struct FrameReader<S: LinkService> {
    receiver: FrameReceiver<S>,
    kept: Option<FrameSample<S>>,
}

impl<S: LinkService> FrameReader<S> {
    fn new(receiver: FrameReceiver<S>) -> Self {
        Self { receiver, kept: None }
    }

    fn receive(&mut self, accept: &mut dyn FnMut(Frame<'_>) -> bool) -> Result<bool, LinkError> {
        let mut accepted = false;
        while let Some(sample) = self.receiver.receive().map_err(|_| LinkError::Frames)? {
            if accept(frame_of(&sample)) {
                self.kept = Some(sample);
                accepted = true;
            }
        }
        Ok(accepted)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        self.kept.as_ref().map(frame_of)
    }
}

fn frame_of<S: LinkService>(sample: &FrameSample<S>) -> Frame<'_> {
    Frame { header: sample.user_header().message(), payload: sample.payload().as_bytes() }
}

impl<S: LinkService> FrameTx for IoxWorld<S> {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        self.frames.send(fill)
    }
}

impl<S: LinkService> ActionRx for IoxWorld<S> {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        drain(&self.actions, LinkError::Actions, take)
    }
}

impl<S: LinkService> AllocRx for IoxWorld<S> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        drain(&self.allocations, LinkError::Allocations, take)
    }
}

impl<S: LinkService> StatRx for IoxWorld<S> {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        drain(&self.statuses, LinkError::Statuses, take)
    }
}

impl<S: LinkService> StatTx for IoxWorld<S> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        send(&self.own_status, LinkError::Statuses, status)
    }
}

impl<S: LinkService> AllocRx for IoxAgent<S> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        drain(&self.allocations, LinkError::Allocations, take)
    }
}

impl<S: LinkService> ActionTx for IoxAgent<S> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        send(&self.actions, LinkError::Actions, action)
    }
}

impl<S: LinkService> AllocTx for IoxAllocator<S> {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        send(&self.allocations, LinkError::Allocations, allocation)
    }
}

macro_rules! reads_frames_and_tells_status {
    ($($link:ident),+) => {$(
        impl<S: LinkService> FrameRx for $link<S> {
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

        impl<S: LinkService> StatTx for $link<S> {
            fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
                send(&self.statuses, LinkError::Statuses, status)
            }
        }
    )+};
}
reads_frames_and_tells_status!(IoxAgent, IoxAllocator);

macro_rules! has_bell_and_clock {
    ($($link:ident),+) => {$(
        impl<S: LinkService> Bell for $link<S> {
            fn token(&self) -> u32 {
                self.bell.token()
            }

            fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
                self.bell.wait(token, self.rings.take(), until_ns)
            }

            fn await_rings(&mut self, rings: u32) {
                self.rings = Some(rings.max(1));
            }

            fn ring(&mut self, role: Role) -> Result<(), LinkError> {
                self.bell.ring(role)
            }
        }

        impl<S: LinkService> Wakeable for $link<S> {
            fn waker(&self) -> Waker {
                self.bell.waker()
            }
        }

        impl<S: LinkService> Clock for $link<S> {
            fn now_ns(&self) -> u64 {
                MonotonicClock.now_ns()
            }
        }
    )+};
}
has_bell_and_clock!(IoxWorld, IoxAgent, IoxAllocator);

impl<S: LinkService> ControlRx for IoxAgent<S> {
    fn answer_requests(&mut self, answer: &mut dyn FnMut(&ControlReq) -> ControlRep) -> bool {
        self.requests.as_ref().is_some_and(|requests| serve(requests, answer))
    }
}

macro_rules! answers_requests {
    ($($link:ident),+) => {$(
        impl<S: LinkService> ControlRx for $link<S> {
            fn answer_requests(
                &mut self,
                answer: &mut dyn FnMut(&ControlReq) -> ControlRep,
            ) -> bool {
                serve(&self.requests, answer)
            }
        }
    )+};
}
answers_requests!(IoxWorld, IoxAllocator);
