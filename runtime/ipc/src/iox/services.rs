//! The table of all services, and what passes over them. Every process opens them with these numbers and no others, so
//! that it does not matter who comes first.

use std::time::Duration;

use iceoryx2::prelude::ZeroCopySend;
use sortie_core::wire::{
    ActionMsg, AllocMsg, ControlRep, ControlReq, FrameFormat, FrameHeader, FrameLayout, Role,
    StatMsg,
};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, transmute, transmute_ref};

use crate::domain::{BellKind, Domain, DomainFacts};
use crate::error::Error;

/// One publish-subscribe service.
#[derive(Clone, Copy, Debug)]
pub(super) struct Topic {
    pub(super) name: &'static str,
    pub(super) publishers: usize,
    pub(super) subscribers: usize,
    /// Messages that wait for a subscriber; the oldest gives way.
    pub(super) buffer: usize,
    /// The same for who records and may miss none of them, however late it runs. All subscribers have room for them: the
    /// library knows no other way.
    pub(super) recorded: usize,
    /// Messages that a late subscriber gets.
    pub(super) history: usize,
    /// Messages that a subscriber may hold.
    pub(super) borrow: usize,
    /// Messages that a publisher may fill at once.
    pub(super) loan: usize,
}

impl Topic {
    /// The topic as who records opens it.
    pub(super) fn for_recorder(self) -> Self {
        Self { buffer: self.recorded, ..self }
    }
}

/// Ticks by which who records may be late.
const RECORDED_TICKS: usize = 16;

pub(super) fn frames(agents: usize) -> Topic {
    Topic {
        name: "sortie/1/frame",
        publishers: 2,
        subscribers: agents + 16,
        buffer: 2,
        recorded: RECORDED_TICKS,
        history: 1,
        borrow: 2,
        loan: 1,
    }
}

/// The frames of one agent alone, in a domain whose frames are private; each agent has its own service.
pub(super) fn private_frames() -> Topic {
    let frames = frames(0);
    Topic { subscribers: 4, recorded: frames.buffer, ..frames }
}

/// Name of the service of `agent`'s private frames.
pub(super) fn private_frames_name(agent: usize) -> String {
    format!("{}/{agent}", frames(0).name)
}

pub(super) fn actions(agents: usize) -> Topic {
    Topic {
        name: "sortie/1/act",
        publishers: agents + 8,
        subscribers: 8,
        // One runner may act for all agents, and sends one message for each.
        buffer: (2 * agents).max(4),
        recorded: RECORDED_TICKS * agents.max(1),
        history: 0,
        borrow: 2,
        loan: 2,
    }
}

pub(super) fn allocations(agents: usize) -> Topic {
    Topic {
        name: "sortie/1/alloc",
        publishers: 4,
        subscribers: agents + 16,
        buffer: 1,
        recorded: RECORDED_TICKS,
        history: 1,
        borrow: 1,
        loan: 1,
    }
}

pub(super) fn statuses(agents: usize) -> Topic {
    Topic {
        name: "sortie/1/stat",
        publishers: agents + 24,
        subscribers: 8,
        buffer: 2,
        recorded: 2,
        history: 1,
        borrow: 2,
        loan: 1,
    }
}

/// Observations for a served policy. A client that was killed holds its place until it is cleaned up.
pub(super) fn observations() -> Topic {
    Topic {
        name: "sortie/1/policy/observation",
        publishers: 4,
        subscribers: 4,
        buffer: 2,
        recorded: 2,
        history: 0,
        borrow: 2,
        loan: 1,
    }
}

/// Its answers.
pub(super) fn answers() -> Topic {
    Topic { name: "sortie/1/policy/answer", ..observations() }
}

/// What the server of a policy tells of itself.
pub(super) fn served_statuses() -> Topic {
    Topic { name: "sortie/1/policy/stat", publishers: 4, ..statuses(0) }
}

/// What it is told.
pub(super) fn served_control() -> Control {
    Control { name: "sortie/1/policy/ctl", servers: 4, ..control(0) }
}

/// The request-response service.
#[derive(Clone, Copy, Debug)]
pub(super) struct Control {
    pub(super) name: &'static str,
    pub(super) clients: usize,
    pub(super) servers: usize,
    /// Requests of a client that wait for an answer.
    pub(super) active: usize,
    /// Answers of each server that wait for the client.
    pub(super) buffer: usize,
}

pub(super) fn control(agents: usize) -> Control {
    // Every process serves it: as many as may act, world and allocators, and those that are not cleaned up.
    Control { name: "sortie/1/ctl", clients: 8, servers: agents + 8, active: 2, buffer: 1 }
}

/// Largest event id of the bells.
pub(super) const BELL_IDS: usize = 127;

/// Id with which `role` rings.
pub(super) fn bell_id(role: Role) -> usize {
    64 + role as usize
}

/// Name of the bell that wakes all processes of `role`, if it has one.
pub(super) fn bell_name(role: Role) -> Option<&'static str> {
    match role {
        Role::World => Some("sortie/1/wake/world"),
        Role::Runner => Some("sortie/1/wake/agents"),
        Role::Allocator => Some("sortie/1/wake/alloc"),
        Role::Supervisor | Role::Bridge | Role::Watcher => None,
    }
}

/// Most listeners, and most ringers, of a bell.
pub(super) fn bell_ports(agents: usize) -> usize {
    agents + 24
}

/// Most processes of a domain.
pub(super) fn processes(agents: usize) -> usize {
    agents + 32
}

/// Messages that a publisher of a topic has room for.
pub(super) fn slots(topic: Topic) -> usize {
    topic.subscribers * (topic.recorded + topic.borrow) + topic.history + topic.loan + 1
}

/// Shared memory of one process that tells of itself.
pub(super) fn status_bytes(topic: Topic) -> usize {
    slots(topic) * 576
}

/// Shared memory of one process that answers requests.
pub(super) fn control_bytes(control: Control) -> usize {
    let Control { clients, active, buffer, .. } = control;
    clients * (active * (buffer + 1) + 1) * 320
}

/// Shared memory that the domain's publishers take at most, in bytes.
pub(crate) fn worst_case_bytes(facts: &DomainFacts) -> Result<u64, Error> {
    let private = facts.has_private_frames().then(|| facts.private_format(0)).transpose()?;
    let private = private.as_ref().map(|format| &format.layout);
    Ok(worst_case_bytes_of(&facts.format()?.layout, private))
}

/// The same by layouts; `private`: that of the private frames, if the domain has such.
fn worst_case_bytes_of(layout: &FrameLayout, private: Option<&FrameLayout>) -> u64 {
    let agents = layout.shape().agents;
    // A world, a runner per agent, an allocator; each of them says hello.
    let frames = slots(frames(agents)) * (layout.payload_bytes() + 128);
    let private = private
        .map_or(0, |layout| agents * slots(private_frames()) * (layout.payload_bytes() + 128));
    let actions = agents * slots(actions(agents)) * 128;
    let allocations = slots(allocations(agents)) * 192;
    let statuses = (agents + 2) * status_bytes(statuses(agents));
    let answers = (agents + 2) * control_bytes(control(agents));
    (frames + private + actions + allocations + statuses + answers) as u64
}

/// What a link is opened with.
#[derive(Clone, Copy, Debug)]
pub struct LinkSetup<'a> {
    /// The domain, which this process has entered.
    pub domain: &'a Domain,
    /// Its frames.
    pub format: FrameFormat,
    /// Name of the process's node and ports.
    pub name: &'a str,
    /// How its processes wake each other.
    pub bell: BellKind,
    /// How long waits linger before they sleep; with doorbells only.
    pub linger: Duration,
}

/// Unit of messages of bytes. Bytes of their own kind that begin at multiples of 64 would each take 64: the library
/// rounds every element of a slice up to the alignment of the whole.
#[derive(Clone, Copy, Debug, ZeroCopySend, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
#[repr(align(64))]
#[type_name("sortie.Block.v1")]
pub(super) struct Block([u8; 64]);

impl Block {
    /// Blocks that hold so many bytes.
    pub(super) fn holding(bytes: usize) -> usize {
        bytes.div_ceil(size_of::<Self>())
    }
}

impl Default for Block {
    fn default() -> Self {
        Self([0; 64])
    }
}

/// A wire message inside an iceoryx2 payload: named, and marked as sendable by its own trait, which cannot be
/// implemented for types of another crate.
pub(super) trait Message: ZeroCopySend + std::fmt::Debug + Copy + 'static {
    type Wire;

    fn wrap(message: &Self::Wire) -> Self;
    fn message(&self) -> &Self::Wire;
}

macro_rules! message {
    ($payload:ident, $wire:ident, $name:literal, $words:literal) => {
        #[doc = concat!("Payload `", $name, "`.")]
        #[derive(
            Clone, Copy, Debug, ZeroCopySend, FromBytes, IntoBytes, Immutable, KnownLayout,
        )]
        #[repr(C)]
        #[repr(align(64))]
        #[type_name($name)]
        pub(super) struct $payload([u64; $words]);

        impl Message for $payload {
            type Wire = $wire;

            fn wrap(message: &$wire) -> Self {
                transmute!(*message)
            }

            fn message(&self) -> &$wire {
                transmute_ref!(self)
            }
        }
    };
}

message!(ActionPayload, ActionMsg, "sortie.ActionMsg.v1", 8);
message!(AllocPayload, AllocMsg, "sortie.AllocMsg.v1", 16);
message!(StatPayload, StatMsg, "sortie.StatMsg.v1", 64);
message!(RequestPayload, ControlReq, "sortie.ControlReq.v1", 8);
message!(AnswerPayload, ControlRep, "sortie.ControlRep.v1", 32);
message!(FrameHeaderPayload, FrameHeader, "sortie.FrameHeader.v1", 8);

impl Default for FrameHeaderPayload {
    fn default() -> Self {
        Self::wrap(&FrameHeader::default())
    }
}
