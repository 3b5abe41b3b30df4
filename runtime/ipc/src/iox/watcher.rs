//! How a domain is looked after from outside: requests to its processes, and the link of a supervisor.

use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::*;
use sortie_core::NO_ACTION;
use sortie_core::link::{AllocRx, LinkError, StatRx, StatTx};
use sortie_core::wire::{
    ABI, ActionMsg, AllocMsg, ControlRep, ControlReq, FrameFormat, FrameHeader, FrameView, Role,
    StatMsg,
};
use zerocopy::{FromZeros, IntoBytes};

use super::open::{Receiver, RequestClient, RequestServer, Sender, config, drain, send};
use super::opener::{FrameReceiver, FrameTopic, Opener};
use super::services::{
    self, ActionPayload, AllocPayload, AnswerPayload, LinkSetup, Message, RequestPayload,
    StatPayload,
};
use super::{InterProcess, LinkService};
use crate::domain::{BellKind, Domain};
use crate::doorbell::Doorbell;
use crate::error::Error;

/// Sees frames, allocations and statuses of a domain, and says goodbye for the dead.
pub struct IoxWatcher<S: LinkService = InterProcess> {
    format: FrameFormat,
    frames: FrameReceiver<S>,
    /// Kept open, so that they outlive a world and its runners; never read.
    _private: Vec<FrameTopic<S>>,
    allocations: Receiver<S, AllocPayload>,
    statuses: Receiver<S, StatPayload>,
    own_status: Sender<S, StatPayload>,
    actions: Sender<S, ActionPayload>,
    bells: Bells<S>,
    /// Dropped last.
    _node: Node<S>,
}

/// The bells of the others: a watcher has none of its own.
pub(super) enum Bells<S: LinkService> {
    Doorbell(Doorbell),
    Events(Vec<(Role, Notifier<S>)>),
}

/// The newest frame, in short.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameNews {
    /// Its tick: the world's term in the upper half.
    pub tick: u64,
    /// The world's term.
    pub world_term: u32,
    /// The newest tick that asked for an allocation.
    pub decision_tick: u64,
    /// Whether the world stands still with it.
    pub is_pause: bool,
    /// Whether the world ends with it.
    pub is_last: bool,
}

impl<S: LinkService> IoxWatcher<S> {
    /// Opens all topics and bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        Self::open_with(setup, 0)
    }

    /// The same in a domain whose frames are private, whose services it keeps open as well. It sees the world's
    /// frames where an allocator gets them.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_private(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        Self::open_with(setup, setup.format.layout.shape().agents)
    }

    fn open_with(setup: &LinkSetup<'_>, private: usize) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        let bells = Bells::open(&opener)?;
        let private = (0..private).map(|agent| opener.frames(Some(agent)));
        Ok(Self {
            format: setup.format,
            frames: opener.frame_receiver(None)?,
            _private: private.collect::<Result<_, _>>()?,
            allocations: opener.receiver(services::allocations)?,
            statuses: opener.receiver(services::statuses)?,
            own_status: opener.sender(services::statuses)?,
            actions: opener.sender(services::actions)?,
            bells,
            _node: opener.into_node(),
        })
    }

    /// The newest frame since the last call.
    ///
    /// # Errors
    /// [`LinkError::Frames`].
    pub fn newest_frame(&mut self) -> Result<Option<FrameNews>, LinkError> {
        let mut newest = None;
        while let Some(sample) = self.frames.receive().map_err(|_| LinkError::Frames)? {
            let header = sample.user_header().message();
            if let Ok(view) = FrameView::new(header, sample.payload().as_bytes(), &self.format) {
                newest = Some(FrameNews {
                    tick: header.tick,
                    world_term: header.world_term,
                    decision_tick: view.decision_tick(),
                    is_pause: header.has(FrameHeader::PAUSED),
                    is_last: header.has(FrameHeader::SHUTDOWN),
                });
            }
        }
        Ok(newest)
    }

    /// Says goodbye for a runner that died: its seats are vacant at once, and nobody waits for it.
    ///
    /// # Errors
    /// [`LinkError::Actions`], [`LinkError::Bell`].
    pub fn bury_runner(&mut self, pid: u32, agents: u64) -> Result<(), LinkError> {
        for agent in (0..u64::BITS as u16).filter(|agent| agents >> agent & 1 == 1) {
            let goodbye = ActionMsg {
                schema: self.format.schema,
                agent,
                action: NO_ACTION,
                flags: ActionMsg::BYE,
                abi: ABI as u8,
                runner: pid,
                ..ActionMsg::new_zeroed()
            };
            send(&self.actions, LinkError::Actions, &goodbye)?;
        }
        self.bells.ring(Role::World)
    }
}

impl<S: LinkService> Bells<S> {
    pub(super) fn open(opener: &Opener<'_, S>) -> Result<Self, Error> {
        let setup = opener.setup;
        Ok(match setup.bell {
            BellKind::Doorbell => {
                Self::Doorbell(Doorbell::open(setup.domain, Role::Watcher, Duration::ZERO)?)
            }
            BellKind::Event => Self::Events(notifiers(opener)?),
        })
    }

    pub(super) fn ring(&self, role: Role) -> Result<(), LinkError> {
        match self {
            Self::Doorbell(bell) => bell.ring(role),
            Self::Events(peers) => peers
                .iter()
                .filter(|(peer, _)| *peer == role)
                .try_for_each(|(_, peer)| peer.notify().map(drop))
                .map_err(|_| LinkError::Bell),
        }
    }
}

/// Nodes of dead processes that nobody has cleaned up, and those in a state that nobody can.
pub(crate) fn dead_nodes(domain: &Domain) -> Result<usize, Error> {
    let mut dead = 0;
    let listed = Node::<InterProcess>::list(&config(domain)?, |state| {
        dead += usize::from(matches!(state, NodeState::Dead(_) | NodeState::Undefined(_)));
        CallbackProgression::Continue
    });
    listed.map(|()| dead).map_err(|error| Error::SharedMemory {
        what: "nodes".to_string(),
        problem: format!("{error:?}"),
    })
}

fn notifiers<S: LinkService>(opener: &Opener<'_, S>) -> Result<Vec<(Role, Notifier<S>)>, Error> {
    let roles = [Role::World, Role::Runner, Role::Allocator];
    let named = roles.into_iter().filter_map(|role| Some((role, services::bell_name(role)?)));
    named.map(|(role, name)| Ok((role, opener.notifier(name, Role::Watcher)?))).collect()
}

impl<S: LinkService> AllocRx for IoxWatcher<S> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        drain(&self.allocations, LinkError::Allocations, take)
    }
}

impl<S: LinkService> StatRx for IoxWatcher<S> {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        drain(&self.statuses, LinkError::Statuses, take)
    }
}

impl<S: LinkService> StatTx for IoxWatcher<S> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        send(&self.own_status, LinkError::Statuses, status)
    }
}

/// Pause between two looks for answers.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Links whose process is told what to do.
pub trait ControlRx {
    /// Answers all requests that wait. Returns whether there was one.
    fn answer_requests(&mut self, answer: &mut dyn FnMut(&ControlReq) -> ControlRep) -> bool;
}

/// A process goes on whatever happens to who asks: what fails here is not answered.
pub(super) fn serve<S: LinkService>(
    server: &RequestServer<S>,
    answer: &mut dyn FnMut(&ControlReq) -> ControlRep,
) -> bool {
    let mut is_asked = false;
    while let Ok(Some(request)) = server.receive() {
        is_asked = true;
        let _ = request.send_copy(AnswerPayload::wrap(&answer(request.payload().message())));
    }
    is_asked
}

/// Tells the processes of a domain what to do.
pub struct IoxControl<S: LinkService = InterProcess> {
    client: RequestClient<S>,
    bells: Bells<S>,
    /// Dropped last.
    _node: Node<S>,
}

impl<S: LinkService> IoxControl<S> {
    /// Opens the service and the bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        let bells = Bells::open(&opener)?;
        Ok(Self::new(opener.control_client()?, bells, opener.into_node()))
    }

    pub(super) fn new(client: RequestClient<S>, bells: Bells<S>, node: Node<S>) -> Self {
        Self { client, bells, _node: node }
    }

    /// Asks all processes, and waits until all have answered, `patience` at most.
    ///
    /// # Errors
    /// The request could not be sent.
    pub fn ask(
        &mut self,
        request: &ControlReq,
        patience: Duration,
    ) -> Result<Vec<ControlRep>, Error> {
        let sent = self.client.send_copy(RequestPayload::wrap(request));
        let pending = sent.map_err(|error| Error::SharedMemory {
            what: "sortie/1/ctl".to_string(),
            problem: format!("{error:?}"),
        })?;
        for role in [Role::World, Role::Runner, Role::Allocator] {
            self.bells.ring(role)?;
        }
        let until = Instant::now() + patience;
        let mut answers = Vec::new();
        loop {
            while let Ok(Some(answer)) = pending.receive() {
                answers.push(*answer.payload().message());
            }
            let is_complete = answers.len() >= pending.number_of_server_connections();
            if is_complete || Instant::now() >= until {
                return Ok(answers);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}
