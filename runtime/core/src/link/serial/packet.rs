//! Messages as packets: postcard, and a checksum. Times are not in them, but how much time is left or
//! has passed: the ends of a line have no common clock.

use heapless::Vec;
use serde::{Deserialize, Serialize};
use zerocopy::FromZeros;

use super::line::CHECKSUM;
use crate::allocator::UNASSIGNED;
use crate::checksum::crc32c;
use crate::wire::{ActionMsg, AllocMsg, StatMsg};

/// Room for the longest packet that is not a frame.
pub(super) const SMALL_PACKET: usize = 768;

const MICROSECOND: u64 = 1_000;

/// What stands at the beginning of a packet.
#[derive(Debug, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant, reason = "there is no heap, and one packet at a time")]
pub(super) enum Packet<'a> {
    /// A frame; its rows follow.
    Frame(FramePacket),
    #[serde(borrow)]
    Allocation(AllocationPacket<'a>),
    Action(ActionPacket),
    #[serde(borrow)]
    Status(StatusPacket<'a>),
}

/// Header and head of a frame.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct FramePacket {
    #[serde(with = "postcard::fixint::le")]
    pub(super) schema: u64,
    pub(super) abi: u16,
    pub(super) kind: u16,
    pub(super) seq: u64,
    pub(super) tick: u64,
    /// Microseconds until the deadline, where there is one.
    pub(super) left_us: Option<u64>,
    pub(super) flags: u16,
    pub(super) generation: u16,
    pub(super) world_term: u32,
    pub(super) episode: u32,
    pub(super) open_tasks: u32,
    pub(super) step: u32,
    pub(super) decision_tick: u64,
    pub(super) absent: u64,
    /// The agents whose view follows.
    pub(super) agents: u64,
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct AllocationPacket<'a> {
    #[serde(with = "postcard::fixint::le")]
    schema: u64,
    abi: u8,
    seq: u64,
    tick: u64,
    valid_until: u64,
    term: u32,
    epoch: u32,
    model: u32,
    decide_ns: u32,
    n_agents: u16,
    n_tasks: u8,
    flags: u32,
    task: &'a [u8],
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ActionPacket {
    #[serde(with = "postcard::fixint::le")]
    schema: u64,
    abi: u8,
    seq: u64,
    tick: u64,
    model: u32,
    alloc_epoch: u32,
    agent: u16,
    action: u16,
    flags: u16,
    task: u8,
    q: f32,
    decide_ns: u32,
    alloc_term: u32,
    runner: u32,
}

/// Zeros at the end of a list are left out.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct StatusPacket<'a> {
    #[serde(with = "postcard::fixint::le")]
    schema: u64,
    abi: u8,
    role: u8,
    seq: u64,
    /// Microseconds since the process's start.
    age_us: u64,
    pid: u32,
    n_agents: u16,
    agents: u64,
    last_tick: u64,
    model: [u8; 16],
    build: u32,
    flags: u32,
    counters: Vec<u64, 16>,
    hist_wake: Vec<u32, 32>,
    hist_work: Vec<u32, 32>,
    name: &'a [u8],
}

impl<'a> AllocationPacket<'a> {
    pub(super) fn new(message: &'a AllocMsg) -> Self {
        let AllocMsg { schema, abi, seq, tick, valid_until, term, epoch, .. } = *message;
        let AllocMsg { model, decide_ns, n_agents, n_tasks, flags, .. } = *message;
        let task = message.task.get(..usize::from(n_agents)).unwrap_or(&message.task);
        Self {
            schema,
            abi,
            seq,
            tick,
            valid_until,
            term,
            epoch,
            model,
            decide_ns,
            n_agents,
            n_tasks,
            flags,
            task,
        }
    }

    /// The message, received at `now_ns`; `None` where it has more agents than there can be.
    pub(super) fn message(&self, now_ns: u64) -> Option<AllocMsg> {
        let mut task = [UNASSIGNED; _];
        task.get_mut(..self.task.len())?.copy_from_slice(self.task);
        Some(AllocMsg {
            schema: self.schema,
            seq: self.seq,
            tick: self.tick,
            t_ns: now_ns,
            valid_until: self.valid_until,
            term: self.term,
            epoch: self.epoch,
            model: self.model,
            decide_ns: self.decide_ns,
            n_agents: self.n_agents,
            n_tasks: self.n_tasks,
            abi: self.abi,
            flags: self.flags,
            task,
        })
    }
}

impl ActionPacket {
    pub(super) fn new(message: &ActionMsg) -> Self {
        let ActionMsg { schema, abi, seq, tick, model, alloc_epoch, agent, action, .. } = *message;
        let ActionMsg { flags, task, q, decide_ns, alloc_term, runner, .. } = *message;
        Self {
            schema,
            abi,
            seq,
            tick,
            model,
            alloc_epoch,
            agent,
            action,
            flags,
            task,
            q,
            decide_ns,
            alloc_term,
            runner,
        }
    }

    /// The message, received at `now_ns`.
    pub(super) fn message(&self, now_ns: u64) -> ActionMsg {
        ActionMsg {
            schema: self.schema,
            seq: self.seq,
            tick: self.tick,
            t_ns: now_ns,
            model: self.model,
            alloc_epoch: self.alloc_epoch,
            agent: self.agent,
            action: self.action,
            flags: self.flags,
            task: self.task,
            abi: self.abi,
            q: self.q,
            decide_ns: self.decide_ns,
            alloc_term: self.alloc_term,
            runner: self.runner,
        }
    }
}

impl<'a> StatusPacket<'a> {
    pub(super) fn new(message: &'a StatMsg) -> Self {
        Self {
            schema: message.schema,
            abi: message.abi,
            role: message.role,
            seq: message.seq,
            age_us: message.t_ns.saturating_sub(message.start_ns) / MICROSECOND,
            pid: message.pid,
            n_agents: message.n_agents,
            agents: message.agents,
            last_tick: message.last_tick,
            model: message.model,
            build: message.build,
            flags: message.flags,
            counters: list(&message.counters),
            hist_wake: list(&message.hist_wake),
            hist_work: list(&message.hist_work),
            name: without_zeros(&message.name),
        }
    }

    /// The message, received at `now_ns`; `None` where its name is too long.
    pub(super) fn message(&self, now_ns: u64) -> Option<StatMsg> {
        let mut message = StatMsg {
            schema: self.schema,
            seq: self.seq,
            t_ns: now_ns,
            start_ns: now_ns.saturating_sub(self.age_us.saturating_mul(MICROSECOND)),
            pid: self.pid,
            role: self.role,
            abi: self.abi,
            n_agents: self.n_agents,
            agents: self.agents,
            last_tick: self.last_tick,
            model: self.model,
            build: self.build,
            flags: self.flags,
            ..StatMsg::new_zeroed()
        };
        message.counters.get_mut(..self.counters.len())?.copy_from_slice(&self.counters);
        message.hist_wake.get_mut(..self.hist_wake.len())?.copy_from_slice(&self.hist_wake);
        message.hist_work.get_mut(..self.hist_work.len())?.copy_from_slice(&self.hist_work);
        message.name.get_mut(..self.name.len())?.copy_from_slice(self.name);
        Some(message)
    }
}

fn without_zeros<T: Default + PartialEq>(items: &[T]) -> &[T] {
    let mut rest = items;
    while let [shorter @ .., last] = rest {
        if *last != T::default() {
            break;
        }
        rest = shorter;
    }
    rest
}

fn list<T: Copy + Default + PartialEq, const N: usize>(items: &[T; N]) -> Vec<T, N> {
    Vec::from_slice(without_zeros(items)).unwrap_or_default()
}

/// Writes a packet.
pub(super) struct Packer<'a> {
    bytes: &'a mut [u8],
    len: usize,
}

impl<'a> Packer<'a> {
    pub(super) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, len: 0 }
    }

    /// `None`: there is no room.
    pub(super) fn put(&mut self, value: &impl Serialize) -> Option<()> {
        let room = self.bytes.get_mut(self.len..)?;
        self.len += postcard::to_slice(value, room).ok()?.len();
        Some(())
    }

    /// Adds the checksum. Returns the packet.
    pub(super) fn seal(self) -> Option<&'a [u8]> {
        let end = self.len.checked_add(CHECKSUM)?;
        let packet = self.bytes.get_mut(..end)?;
        let (body, sum) = packet.split_last_chunk_mut::<CHECKSUM>()?;
        *sum = crc32c(body).to_le_bytes();
        Some(packet)
    }
}

/// Reads a packet.
pub(super) struct Unpacker<'a>(pub(super) &'a [u8]);

impl<'a> Unpacker<'a> {
    /// `None`: the rest is something else.
    pub(super) fn take<T: Deserialize<'a>>(&mut self) -> Option<T> {
        let (value, rest) = postcard::take_from_bytes(self.0).ok()?;
        self.0 = rest;
        Some(value)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
