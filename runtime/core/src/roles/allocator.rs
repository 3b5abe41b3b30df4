//! The allocator: a new allocation for every frame that asks for one.
//!
//! Of several allocators one leads; which one, a lock outside decides. The others stand by: they read
//! all frames, so that whoever is told to lead next answers the newest frame at once.

use super::feasible::allocate;
use super::presence::Presence;
use super::runner::is_next_world;
use super::{Counters, IDLE, Identity, Poll};
use crate::allocator::{AllocateError, Allocator, UNASSIGNED};
use crate::limits;
use crate::link::{AllocLink, Frame, LinkError};
use crate::wire::{
    ABI, AllocMsg, FrameError, FrameFormat, FrameHeader, FrameKind, FrameView, Role, StatMsg,
};

/// What an allocator process is started with.
#[derive(Clone, Copy, Debug)]
pub struct AllocatorOptions {
    /// The domain's frames.
    pub format: FrameFormat,
    /// Who this is.
    pub identity: Identity,
    /// Ticks for which an allocation is meant to hold.
    pub decision_interval: u32,
}

/// Why the allocator ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum AllocatorError {
    /// A topic failed.
    Link(LinkError),
    /// The rules refused a state.
    Refused {
        /// The frame.
        tick: u64,
        /// Why.
        reason: AllocateError,
    },
}

impl core::fmt::Display for AllocatorError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Link(error) => write!(f, "{error}"),
            Self::Refused { tick, reason } => {
                write!(f, "no allocation for step {}: {reason}", *tick as u32)
            }
        }
    }
}

impl core::error::Error for AllocatorError {}

impl From<LinkError> for AllocatorError {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

/// Who publishes allocations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leadership {
    /// Another allocator does.
    StandsBy,
    /// This one does, and has published `epoch` allocations of its term.
    Leads { term: u32, epoch: u32 },
}

/// The allocator as a state machine.
pub struct AllocatorRole {
    options: AllocatorOptions,
    leadership: Leadership,
    /// The world has not been told of a change of leadership.
    is_leadership_news: bool,
    seen_tick: u64,
    done_decision: u64,
    /// The frame kept by the link has just come.
    is_new: bool,
    allocations: u64,
    presence: Presence,
    counters: Counters,
}

impl AllocatorRole {
    /// An allocator that stands by and has seen nothing yet.
    pub fn new(options: AllocatorOptions) -> Self {
        Self {
            options,
            leadership: Leadership::StandsBy,
            is_leadership_news: false,
            seen_tick: 0,
            done_decision: 0,
            is_new: false,
            allocations: 0,
            presence: Presence::default(),
            counters: Counters::default(),
        }
    }

    /// What it has counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// For what only the loop around the role can count.
    pub fn counters_mut(&mut self) -> &mut Counters {
        &mut self.counters
    }

    /// Its model is another one from now on.
    pub fn change_model(&mut self, model: [u8; 16]) {
        self.options.identity.model = model;
    }

    /// The newest tick seen.
    pub fn tick(&self) -> u64 {
        self.seen_tick
    }

    /// The term that it leads, if it does.
    pub fn term(&self) -> Option<u32> {
        match self.leadership {
            Leadership::StandsBy => None,
            Leadership::Leads { term, .. } => Some(term),
        }
    }

    /// Leads from now on: the lock has been acquired, and `term` is larger than that of every earlier
    /// leader of the domain. The next poll answers the newest frame, whether or not it asks.
    pub fn lead(&mut self, term: u32) {
        self.leadership = Leadership::Leads { term, epoch: 0 };
        self.is_leadership_news = true;
    }

    /// Stands by from now on, after which the lock may be released.
    pub fn stand_by(&mut self) {
        self.leadership = Leadership::StandsBy;
        self.is_leadership_news = true;
    }

    /// Announces the allocator to the world.
    ///
    /// # Errors
    /// A topic failed.
    pub fn join(&mut self, link: &mut impl AllocLink) -> Result<(), LinkError> {
        self.send_status(link, StatMsg::HELLO)?;
        link.ring(Role::World)
    }

    /// Says goodbye to the world.
    ///
    /// # Errors
    /// A topic failed.
    pub fn leave(&mut self, link: &mut impl AllocLink) -> Result<(), LinkError> {
        self.send_status(link, StatMsg::BYE)?;
        link.ring(Role::World)
    }

    fn send_status(&mut self, link: &mut impl AllocLink, flags: u32) -> Result<(), LinkError> {
        let leader = if self.term().is_some() { StatMsg::LEADER } else { 0 };
        let domain = (self.options.format.schema, Role::Allocator);
        let Self { options, counters, .. } = self;
        let now = link.now_ns();
        let told = self.presence.tell(&options.identity, domain, counters, flags | leader, now);
        self.is_leadership_news = false;
        link.send_status(&StatMsg { last_tick: self.seen_tick, ..told })
    }

    /// Looks at the newest frame and answers it if it asks for an allocation.
    ///
    /// # Errors
    /// See [`AllocatorError`].
    pub fn poll<A: Allocator + ?Sized>(
        &mut self,
        link: &mut impl AllocLink,
        allocator: &mut A,
    ) -> Result<Poll, AllocatorError> {
        self.receive(link)?;
        self.answer(link, allocator)
    }

    /// The first half of [`Self::poll`]: takes in the newest frame, and answers nothing.
    ///
    /// # Errors
    /// A topic failed.
    pub fn receive(&mut self, link: &mut impl AllocLink) -> Result<(), LinkError> {
        self.is_new |= link.receive_frames(&mut |frame| self.accepts(frame))?;
        Ok(())
    }

    /// The generation of the bundle that the newest frame asks for, once one has been received.
    pub fn asked_generation(&self, link: &impl AllocLink) -> Option<u16> {
        link.frame().map(|frame| frame.header.generation)
    }

    /// The second half of [`Self::poll`], which answers what [`Self::receive`] took in: for callers that change allocators in
    /// between, by [`Self::asked_generation`].
    ///
    /// # Errors
    /// See [`AllocatorError`].
    pub fn answer<A: Allocator + ?Sized>(
        &mut self,
        link: &mut impl AllocLink,
        allocator: &mut A,
    ) -> Result<Poll, AllocatorError> {
        self.answer_by(link, &mut |view, task| allocate(allocator, view, task).map(|()| 0))
    }

    /// As [`Self::poll`]; where `allocator` refuses a state, `heuristic` allocates, and the message says so.
    ///
    /// # Errors
    /// A topic failed, or both refuse.
    pub fn poll_with_heuristic<A: Allocator + ?Sized, H: Allocator + ?Sized>(
        &mut self,
        link: &mut impl AllocLink,
        allocator: &mut A,
        heuristic: &mut H,
    ) -> Result<Poll, AllocatorError> {
        self.receive(link)?;
        self.answer_by(link, &mut |view, task| match allocate(allocator, view, task) {
            Ok(()) => Ok(0),
            Err(_) => allocate(heuristic, view, task).map(|()| AllocMsg::HEURISTIC),
        })
    }

    fn answer_by(
        &mut self,
        link: &mut impl AllocLink,
        rules: &mut Rules<'_>,
    ) -> Result<Poll, AllocatorError> {
        let accepted = core::mem::take(&mut self.is_new);
        let is_first = matches!(self.leadership, Leadership::Leads { epoch: 0, .. });
        let kept = if accepted || is_first { link.frame() } else { None };
        let Some(view) = kept.and_then(|frame| self.view(frame).ok()) else {
            return self.rest(link);
        };
        if view.header().has(FrameHeader::SHUTDOWN) {
            return Ok(Poll::Ended);
        }
        let asks = view.header().asks_for_actions() && view.decision_tick() > self.done_decision;
        if self.term().is_none() || !(asks || is_first) {
            return self.rest(link);
        }
        let tick = view.header().tick;
        let started = link.now_ns();
        let mut task = [UNASSIGNED; limits::AGENTS];
        let flags =
            rules(&view, &mut task).map_err(|reason| AllocatorError::Refused { tick, reason })?;
        let done = link.now_ns();
        if accepted {
            self.presence.wakes.note(started.saturating_sub(view.header().t_ns));
        }
        self.presence.works.note(done.saturating_sub(started));
        self.done_decision = view.decision_tick();
        if let Some(message) = self.message(&view, task, flags, (started, done)) {
            self.counters.ticks += 1;
            link.send_allocation(&message)?;
            link.ring(Role::Runner)?;
            link.ring(Role::World)?;
        }
        // Who leads is told when the allocation is on its way.
        Ok(if self.is_leadership_news { Poll::Again } else { Poll::Answered })
    }

    /// Nothing to allocate: tells who leads if that changed, and now and then that it is there.
    fn rest(&mut self, link: &mut impl AllocLink) -> Result<Poll, AllocatorError> {
        let is_news = self.is_leadership_news;
        if is_news || self.presence.is_due(link.now_ns()) {
            self.send_status(link, 0)?;
        }
        if is_news {
            link.ring(Role::World)?;
        }
        Ok(IDLE)
    }

    /// The next message of this leader; `None` once a term has no epochs left: it stands by then.
    fn message(
        &mut self,
        view: &FrameView<'_>,
        task: [u8; limits::AGENTS],
        flags: u32,
        (started, done): (u64, u64),
    ) -> Option<AllocMsg> {
        let Leadership::Leads { term, epoch } = self.leadership else { return None };
        let Some(epoch) = epoch.checked_add(1) else {
            self.stand_by();
            return None;
        };
        self.leadership = Leadership::Leads { term, epoch };
        self.allocations += 1;
        let shape = self.options.format.layout.shape();
        let present = view.allocation_state().present;
        let all_present = (0..shape.agents).all(|agent| present.contains(agent));
        let first = if epoch == 1 { AllocMsg::FIRST_OF_TERM } else { 0 };
        let partial = if all_present { 0 } else { AllocMsg::PARTIAL };
        let tick = view.header().tick;
        // Pipelined agents act on the allocation of an earlier tick while this one is computed.
        let intervals = if view.header().has(FrameHeader::PIPELINED_ALLOC) { 2 } else { 1 };
        let valid_for = intervals * u64::from(self.options.decision_interval);
        Some(AllocMsg {
            schema: self.options.format.schema,
            seq: self.allocations,
            tick,
            t_ns: done,
            valid_until: tick.saturating_add(valid_for),
            term,
            epoch,
            model: self.options.identity.short_model(),
            decide_ns: u32::try_from(done.saturating_sub(started)).unwrap_or(u32::MAX),
            // The limits of a layout fit the fields.
            n_agents: shape.agents as u16,
            n_tasks: shape.tasks as u8,
            abi: ABI as u8,
            flags: flags | first | partial,
            task,
        })
    }

    fn view<'a>(&self, frame: Frame<'a>) -> Result<FrameView<'a>, FrameError> {
        FrameView::new(frame.header, frame.payload, &self.options.format)
    }

    /// Takes world frames that are newer than all before; counts the others.
    fn accepts(&mut self, frame: Frame<'_>) -> bool {
        match self.view(frame) {
            Err(FrameError::Foreign) => self.counters.schema_rejects += 1,
            Err(_) => self.counters.bad_messages += 1,
            Ok(_) if frame.header.kind != FrameKind::World as u16 => {}
            Ok(_) if frame.header.tick <= self.seen_tick => self.counters.old_term_rejects += 1,
            Ok(_) => {
                let is_restart = is_next_world(self.seen_tick, frame.header);
                self.counters.restarts_seen += u64::from(is_restart);
                self.seen_tick = frame.header.tick;
                return true;
            }
        }
        false
    }
}

/// Allocates a frame, and tells the flags of the message.
type Rules<'a> =
    dyn FnMut(&FrameView<'_>, &mut [u8; limits::AGENTS]) -> Result<u32, AllocateError> + 'a;
