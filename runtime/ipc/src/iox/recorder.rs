//! The link of who records: all that is said in a domain. Nothing is said by it, and nobody waits for it.

use core::ops::Range;

use iceoryx2::prelude::*;
use sortie_core::link::{LinkError, Wake};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};
use zerocopy::IntoBytes;

use super::bell::LinkBell;
use super::open::{Receiver, drain};
use super::opener::{FrameReceiver, Opener};
use super::services::{self, ActionPayload, AllocPayload, Block, LinkSetup, Message, StatPayload};
use super::{InterProcess, LinkService};
use crate::error::Error;

/// A message of a domain.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// What the world showed: its payload lies at an address as [`FrameView`](sortie_core::wire::FrameView) wants.
    Frame(&'a FrameHeader, &'a [u8]),
    /// What an allocator decided.
    Allocation(&'a AllocMsg),
    /// What a runner answered for an agent.
    Action(&'a ActionMsg),
    /// What a process said of itself.
    Status(&'a StatMsg),
}

/// The same, kept.
enum Kept {
    /// Where its payload lies among the blocks of all frames.
    Frame(FrameHeader, Range<usize>),
    Allocation(AllocMsg),
    Action(ActionMsg),
    Status(Box<StatMsg>),
}

impl Kept {
    fn heard<'a>(&'a self, payloads: &'a [Block]) -> Heard<'a> {
        match self {
            Self::Frame(header, place) => {
                let payload = payloads.get(place.clone()).unwrap_or_default().as_bytes();
                // Blocks are whole: what is behind the payload is not part of it.
                let used = payload.len().min(header.len as usize);
                Heard::Frame(header, &payload[..used])
            }
            Self::Allocation(message) => Heard::Allocation(message),
            Self::Action(message) => Heard::Action(message),
            Self::Status(message) => Heard::Status(message),
        }
    }

    /// When it was sent. All clocks of a domain are one.
    fn t_ns(&self) -> u64 {
        match self {
            Self::Frame(header, _) => header.t_ns,
            Self::Allocation(message) => message.t_ns,
            Self::Action(message) => message.t_ns,
            Self::Status(message) => message.t_ns,
        }
    }
}

/// Hears all that is said in a domain.
pub struct IoxRecorder<S: LinkService = InterProcess> {
    frames: FrameReceiver<S>,
    allocations: Receiver<S, AllocPayload>,
    actions: Receiver<S, ActionPayload>,
    statuses: Receiver<S, StatPayload>,
    kept: Vec<Kept>,
    /// Payloads of the frames among them, each at an address as views of it want.
    payloads: Vec<Block>,
    /// That of runners, which is rung for every frame and allocation.
    bell: LinkBell<S>,
    /// Dropped last.
    _node: Node<S>,
}

impl<S: LinkService> IoxRecorder<S> {
    /// Opens all topics to listen. Where frames are private there are whole ones only if somebody allocates.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        Ok(Self {
            frames: opener.frame_recorder()?,
            allocations: opener.recorder(services::allocations)?,
            actions: opener.recorder(services::actions)?,
            statuses: opener.recorder(services::statuses)?,
            kept: Vec::new(),
            payloads: Vec::new(),
            bell: LinkBell::open(&opener, Role::Runner, &[])?,
            _node: opener.into_node(),
        })
    }

    /// All that was said since the last call, in the order in which it was sent. Who does not ask within 16 ticks misses
    /// some of it; numbers of messages (`seq`) show what.
    ///
    /// # Errors
    /// A topic failed.
    pub fn receive(&mut self, take: &mut dyn FnMut(Heard<'_>)) -> Result<(), LinkError> {
        let Self { frames, allocations, actions, statuses, kept, payloads, .. } = self;
        // Copied, for a few of them only may be held at once.
        while let Some(sample) = frames.receive().map_err(|_| LinkError::Frames)? {
            let header = *sample.user_header().message();
            let first = payloads.len();
            payloads.extend(sample.payload());
            kept.push(Kept::Frame(header, first..payloads.len()));
        }
        drain(allocations, LinkError::Allocations, &mut |it| kept.push(Kept::Allocation(*it)))?;
        drain(actions, LinkError::Actions, &mut |it| kept.push(Kept::Action(*it)))?;
        drain(statuses, LinkError::Statuses, &mut |it| kept.push(Kept::Status(Box::new(*it))))?;
        kept.sort_by_key(Kept::t_ns);
        kept.drain(..).for_each(|kept| take(kept.heard(payloads)));
        payloads.clear();
        Ok(())
    }

    /// The state of the bell, to be taken before a look.
    pub fn token(&self) -> u32 {
        self.bell.token()
    }

    /// Sleeps until a frame or an allocation comes, or until then.
    pub fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        self.bell.wait(token, None, until_ns)
    }
}
