//! The allocator: a new allocation for every frame that asks for one.

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
    /// Leadership term, larger than that of every earlier allocator of the domain.
    pub term: u32,
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

/// The allocator as a state machine.
pub struct AllocatorRole {
    options: AllocatorOptions,
    seen_tick: u64,
    done_decision: u64,
    epoch: u32,
    statuses: u64,
    counters: Counters,
}

impl AllocatorRole {
    /// An allocator that has seen nothing yet.
    pub fn new(options: AllocatorOptions) -> Self {
        Self {
            options,
            seen_tick: 0,
            done_decision: 0,
            epoch: 0,
            statuses: 0,
            counters: Counters::default(),
        }
    }

    /// What it has counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Announces the allocator to the world.
    ///
    /// # Errors
    /// A topic failed.
    pub fn join(&mut self, link: &mut impl AllocLink) -> Result<(), LinkError> {
        self.send_status(link, StatMsg::HELLO | StatMsg::LEADER)
    }

    /// Says goodbye to the world.
    ///
    /// # Errors
    /// A topic failed.
    pub fn leave(&mut self, link: &mut impl AllocLink) -> Result<(), LinkError> {
        self.send_status(link, StatMsg::BYE)
    }

    fn send_status(&mut self, link: &mut impl AllocLink, flags: u32) -> Result<(), LinkError> {
        self.statuses += 1;
        let status = StatMsg {
            seq: self.statuses,
            t_ns: link.now_ns(),
            last_tick: self.seen_tick,
            ..self.options.identity.status(self.options.format.schema, Role::Allocator, flags)
        };
        link.send_status(&status)?;
        link.ring(Role::World)
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
        let accepted = link.receive_frames(&mut |frame| self.accepts(frame))?;
        let kept = if accepted { link.frame() } else { None };
        let Some(view) = kept.and_then(|frame| self.view(frame).ok()) else {
            return Ok(IDLE);
        };
        if view.header().has(FrameHeader::SHUTDOWN) {
            return Ok(Poll::Ended);
        }
        if !view.header().asks_for_actions() || view.decision_tick() <= self.done_decision {
            return Ok(IDLE);
        }
        let mut task = [UNASSIGNED; limits::AGENTS];
        let of_agents = task.get_mut(..view.agents()).unwrap_or_default();
        let tick = view.header().tick;
        let started = link.now_ns();
        allocator
            .allocate(&view.allocation_state(), of_agents)
            .map_err(|reason| AllocatorError::Refused { tick, reason })?;
        let done = link.now_ns();
        let message = self.message(&view, task, done, done.saturating_sub(started));
        self.done_decision = view.decision_tick();
        self.counters.ticks += 1;
        link.send_allocation(&message)?;
        link.ring(Role::Runner)?;
        link.ring(Role::World)?;
        Ok(Poll::Again)
    }

    fn message(
        &mut self,
        view: &FrameView<'_>,
        task: [u8; limits::AGENTS],
        t_ns: u64,
        decide_ns: u64,
    ) -> AllocMsg {
        let shape = self.options.format.layout.shape();
        self.epoch += 1;
        let present = view.present();
        let all_present = (0..shape.agents).all(|agent| present.contains(agent));
        let first = if self.epoch == 1 { AllocMsg::FIRST_OF_TERM } else { 0 };
        let partial = if all_present { 0 } else { AllocMsg::PARTIAL };
        let tick = view.header().tick;
        AllocMsg {
            schema: self.options.format.schema,
            seq: u64::from(self.epoch),
            tick,
            t_ns,
            valid_until: tick.saturating_add(u64::from(self.options.decision_interval)),
            term: self.options.term,
            epoch: self.epoch,
            model: self.options.identity.short_model(),
            decide_ns: u32::try_from(decide_ns).unwrap_or(u32::MAX),
            // The limits of a layout fit the fields.
            n_agents: shape.agents as u16,
            n_tasks: shape.tasks as u8,
            abi: ABI as u8,
            flags: first | partial,
            task,
        }
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
                self.seen_tick = frame.header.tick;
                return true;
            }
        }
        false
    }
}
