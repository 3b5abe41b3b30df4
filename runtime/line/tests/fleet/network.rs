//! Topics and bells of the fleet: who has sent what to whom, and when it can be seen there.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use sortie_core::internal::checksum::crc32c;
use sortie_core::link::FrameBlock;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};
use zerocopy::{FromBytes, IntoBytes};

use super::oracle::Oracle;
use super::random::Random;
use super::setup::{MICROSECOND, MILLISECOND, Weather};
use super::toy::ACTIONS;

/// A frame as sent.
#[derive(Clone)]
pub(crate) struct SentFrame {
    pub(crate) header: FrameHeader,
    pub(crate) payload: Vec<FrameBlock>,
}

/// A message on its way to one reader.
struct Waiting<M> {
    visible_ns: u64,
    number: u64,
    from: u32,
    message: M,
}

/// The messages of one topic that wait for one reader.
pub(crate) struct Inbox<M> {
    waiting: Vec<Waiting<M>>,
    /// Messages of one sender that wait at most; the oldest gives way.
    capacity: usize,
}

impl<M> Inbox<M> {
    fn new(capacity: usize) -> Self {
        Self { waiting: Vec::new(), capacity }
    }

    fn push(&mut self, visible_ns: u64, number: u64, from: u32, message: M) {
        let mut of_sender = self.waiting.iter().enumerate().filter(|(_, one)| one.from == from);
        if let Some((oldest, _)) = of_sender.clone().next()
            && of_sender.by_ref().count() >= self.capacity
        {
            self.waiting.remove(oldest);
        }
        self.waiting.push(Waiting { visible_ns, number, from, message });
    }

    fn pop(&mut self, now_ns: u64) -> Option<M> {
        let visible = self.waiting.iter().enumerate().filter(|(_, one)| one.visible_ns <= now_ns);
        let (index, _) = visible.min_by_key(|(_, one)| (one.visible_ns, one.number))?;
        Some(self.waiting.remove(index).message)
    }

    /// Whether a message of a sender of `alive`, for which a wake-up is due, has waited since before `then_ns`.
    fn is_overdue(&self, then_ns: u64, alive: &[u32], rings: impl Fn(&M) -> bool) -> bool {
        let is_overdue = |one: &Waiting<M>| one.visible_ns < then_ns && rings(&one.message);
        self.waiting.iter().any(|one| is_overdue(one) && alive.contains(&one.from))
    }
}

/// What one process has open.
pub(crate) struct Endpoint {
    pub(crate) role: Role,
    /// Killed or gone: it reads nothing and nobody hears of it any more.
    pub(crate) is_dead: bool,
    /// It dies at this one of its next operations, in the middle of what it does.
    pub(crate) operations_left: Option<u32>,
    pub(crate) frames: Inbox<Rc<SentFrame>>,
    pub(crate) actions: Inbox<ActionMsg>,
    pub(crate) allocations: Inbox<AllocMsg>,
    pub(crate) statuses: Inbox<StatMsg>,
    /// When the last thing that it sent in order is seen.
    last_visible_ns: u64,
    /// What late joiners are shown.
    newest_frame: Option<Rc<SentFrame>>,
    newest_allocation: Option<AllocMsg>,
    newest_status: Option<StatMsg>,
}

/// How messages fare, in cases per thousand.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Losses {
    pub(crate) lost: u64,
    pub(crate) doubled: u64,
    /// Late, by up to some milliseconds, and so out of order.
    pub(crate) late: u64,
    pub(crate) damaged: u64,
}

pub(crate) struct Network {
    pub(crate) now_ns: u64,
    pub(crate) random: Random,
    pub(crate) weather: Weather,
    pub(crate) losses: Losses,
    pub(crate) endpoints: BTreeMap<u32, Endpoint>,
    /// Rings that the scheduler has yet to deliver: when, and to whom.
    pub(crate) rings: Vec<(u64, u32)>,
    pub(crate) oracle: Oracle,
    /// What the world reported last.
    pub(crate) allocations_missed: u32,
    sent: u64,
}

pub(crate) type Shared = Rc<RefCell<Network>>;

impl Network {
    pub(crate) fn new(random: Random, weather: Weather, oracle: Oracle) -> Self {
        Self {
            now_ns: 0,
            random,
            weather,
            losses: Losses::default(),
            endpoints: BTreeMap::new(),
            rings: Vec::new(),
            oracle,
            allocations_missed: 0,
            sent: 0,
        }
    }

    /// Opens a process's topics; it is shown the newest message of every process that is there.
    pub(crate) fn open(&mut self, pid: u32, role: Role) {
        let mut opened = Endpoint {
            role,
            is_dead: false,
            operations_left: None,
            frames: Inbox::new(2),
            actions: Inbox::new(128),
            allocations: Inbox::new(1),
            statuses: Inbox::new(2),
            last_visible_ns: 0,
            newest_frame: None,
            newest_allocation: None,
            newest_status: None,
        };
        for (&from, endpoint) in self.endpoints.iter().filter(|(_, one)| !one.is_dead) {
            if let Some(frame) = endpoint.newest_frame.as_ref().filter(|_| role != Role::World) {
                opened.frames.push(self.now_ns, 0, from, frame.clone());
            }
            if let Some(allocation) = endpoint.newest_allocation.filter(|_| role != Role::Allocator)
            {
                opened.allocations.push(self.now_ns, 0, from, allocation);
            }
            if let Some(status) = endpoint.newest_status.filter(|_| role == Role::World) {
                opened.statuses.push(self.now_ns, 0, from, status);
            }
        }
        self.endpoints.insert(pid, opened);
    }

    /// Counts one operation of a process. False once it is dead.
    pub(crate) fn operates(&mut self, pid: u32) -> bool {
        let Some(endpoint) = self.endpoints.get_mut(&pid) else { return false };
        if let Some(left) = &mut endpoint.operations_left {
            *left = left.saturating_sub(1);
            endpoint.is_dead |= *left == 0;
        }
        !endpoint.is_dead
    }

    pub(crate) fn ring(&mut self, pid: u32, role: Role) {
        let after = self.endpoints.get(&pid).map_or(0, |endpoint| endpoint.last_visible_ns);
        for (&peer, endpoint) in &self.endpoints {
            if endpoint.role == role && !endpoint.is_dead {
                let takes = self.random.between(5, 30) * MICROSECOND;
                self.rings.push((self.now_ns.max(after) + takes, peer));
            }
        }
    }

    pub(crate) fn send_frame(&mut self, pid: u32, frame: SentFrame) {
        let frame = Rc::new(frame);
        self.oracle.frame_sent(&frame);
        self.sender(pid).newest_frame = Some(frame.clone());
        let damage = |random: &mut Random, frame: &Rc<SentFrame>| {
            let mut damaged = SentFrame::clone(frame);
            let is_noticed = if random.chance(500) {
                flip(random, damaged.header.as_mut_bytes())
            } else {
                flip(random, damaged.payload.as_mut_bytes())
            };
            (Rc::new(damaged), is_noticed)
        };
        for role in [Role::Runner, Role::Allocator] {
            self.send(pid, role, &frame, damage, |endpoint| &mut endpoint.frames);
        }
    }

    pub(crate) fn send_action(&mut self, pid: u32, action: &ActionMsg) {
        self.oracle.action_sent(self.now_ns, pid, action);
        self.send(pid, Role::World, action, damage_action, |endpoint| &mut endpoint.actions);
    }

    pub(crate) fn send_allocation(&mut self, pid: u32, allocation: &AllocMsg) {
        self.oracle.allocation_sent(self.now_ns, pid, allocation);
        self.sender(pid).newest_allocation = Some(*allocation);
        for role in [Role::Runner, Role::World] {
            self.send(pid, role, allocation, damage, |endpoint| &mut endpoint.allocations);
        }
    }

    pub(crate) fn send_status(&mut self, pid: u32, status: &StatMsg) {
        self.sender(pid).newest_status = Some(*status);
        self.send(pid, Role::World, status, damage, |endpoint| &mut endpoint.statuses);
    }

    fn sender(&mut self, pid: u32) -> &mut Endpoint {
        self.endpoints.get_mut(&pid).expect("a process that sends has an endpoint")
    }

    /// Puts a message into the inboxes of a role, as the losses have it.
    fn send<M: Clone>(
        &mut self,
        pid: u32,
        role: Role,
        message: &M,
        damage: impl Fn(&mut Random, &M) -> (M, bool),
        inbox: impl Fn(&mut Endpoint) -> &mut Inbox<M>,
    ) {
        let losses = self.losses;
        let takes = self.random.between(1, 60) * MICROSECOND;
        let in_order = (self.now_ns + takes).max(self.sender(pid).last_visible_ns);
        self.sender(pid).last_visible_ns = in_order;
        let Self { endpoints, random, weather, sent, .. } = self;
        for endpoint in endpoints.values_mut().filter(|one| one.role == role && !one.is_dead) {
            let copies = if random.chance(losses.doubled) { 2 } else { 1 };
            for _ in 0..copies {
                *sent += 1;
                if random.chance(losses.lost) {
                    continue;
                }
                let is_late = random.chance(losses.late);
                let delay = if is_late { random.between(0, 12 * MILLISECOND) } else { 0 };
                let mut arrives = message.clone();
                if random.chance(losses.damaged) {
                    let (damaged, is_noticed) = damage(random, message);
                    if *weather != Weather::Hostile && is_noticed {
                        continue;
                    }
                    arrives = damaged;
                }
                inbox(endpoint).push(in_order + delay, *sent, pid, arrives);
            }
        }
    }

    /// Whether a process that woke because its time was over finds what it should have been woken for.
    pub(crate) fn missed_wake_up(&self, pid: u32) -> bool {
        let alive = self.endpoints.iter().filter(|(_, one)| !one.is_dead);
        let alive: Vec<u32> = alive.map(|(pid, _)| *pid).collect();
        let then = self.now_ns.saturating_sub(MILLISECOND);
        self.endpoints.get(&pid).is_some_and(|endpoint| {
            endpoint.actions.is_overdue(then, &alive, |_| true)
                || endpoint.allocations.is_overdue(then, &alive, |_| true)
                || endpoint.frames.is_overdue(then, &alive, |frame| wakes(frame, endpoint.role))
        })
    }

    pub(crate) fn next_frame(&mut self, pid: u32) -> Option<Rc<SentFrame>> {
        self.endpoints.get_mut(&pid)?.frames.pop(self.now_ns)
    }

    pub(crate) fn next_action(&mut self, pid: u32) -> Option<ActionMsg> {
        self.endpoints.get_mut(&pid)?.actions.pop(self.now_ns)
    }

    pub(crate) fn next_allocation(&mut self, pid: u32) -> Option<AllocMsg> {
        self.endpoints.get_mut(&pid)?.allocations.pop(self.now_ns)
    }

    pub(crate) fn next_status(&mut self, pid: u32) -> Option<StatMsg> {
        self.endpoints.get_mut(&pid)?.statuses.pop(self.now_ns)
    }
}

/// Whether the world wakes `role` for this frame: agents that have to wait for an allocation are woken
/// by the allocator.
fn wakes(frame: &SentFrame, role: Role) -> bool {
    let header = &frame.header;
    let reallocates = header.has(FrameHeader::REALLOC);
    match role {
        _ if !header.asks_for_actions() => false,
        Role::Allocator => reallocates,
        _ => !reallocates || header.has(FrameHeader::PIPELINED_ALLOC),
    }
}

/// A damaged copy, and whether a checksum notices.
fn damage<M: Clone + FromBytes + IntoBytes>(random: &mut Random, message: &M) -> (M, bool) {
    let mut damaged = message.clone();
    let is_noticed = flip(random, damaged.as_mut_bytes());
    (damaged, is_noticed)
}

/// A damaged action: often one that looks right, for another agent or of another kind.
fn damage_action(random: &mut Random, action: &ActionMsg) -> (ActionMsg, bool) {
    if random.chance(300) {
        return damage(random, action);
    }
    let (agent, chosen) = (random.below(6) as u16, random.below(ACTIONS as u64 + 1) as u16);
    (ActionMsg { agent, action: chosen, ..*action }, true)
}

/// Changes one byte or a few. Returns whether a checksum notices.
fn flip(random: &mut Random, bytes: &mut [u8]) -> bool {
    let before = crc32c(bytes);
    for _ in 0..random.between(1, 4) {
        let at = random.below(bytes.len() as u64) as usize;
        bytes[at] ^= random.between(1, 255) as u8;
    }
    crc32c(bytes) != before
}
