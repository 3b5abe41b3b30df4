//! The runner: acts for one or more agents.

mod deciding;
mod in_force;

use heapless::Vec;
use zerocopy::FromZeros;

use super::newest_allocation::NewestAllocation;
use super::presence::Presence;
use super::{Counters, IDLE, Identity, Poll};
use crate::allocator::{Allocator, UNASSIGNED};
use crate::limits;
use crate::link::{AgentLink, Frame, LinkError};
use crate::policy::{DecideError, NO_ACTION, Observation, Policy};
use crate::wire::{
    ABI, ActionMsg, FrameError, FrameFormat, FrameHeader, FrameKind, FrameView, Role, StatMsg,
};

/// What a runner is started with.
#[derive(Clone, Copy, Debug)]
pub struct RunnerOptions {
    /// The domain's frames; a runner of one agent that gets private ones has the layout of those.
    pub format: FrameFormat,
    /// Who this is.
    pub identity: Identity,
    /// Bit a: it acts for agent a.
    pub agents: u64,
    /// Whether the policy attends only to its own subtask, and so waits for allocations.
    pub subtasks: bool,
    /// Ticks for which an allocation is meant to hold; after it, twice as many are its grace.
    pub decision_interval: u32,
    /// The world's period, as the world is started with; 0 = none.
    pub period_ns: u64,
    /// The contract's safe action.
    pub safe_action: Option<u16>,
}

/// A runner as a state machine.
pub struct RunnerRole {
    options: RunnerOptions,
    /// The frame kept by the link has not been answered.
    pending: bool,
    /// How late this process was for it has been noted.
    is_noted: bool,
    seen_tick: u64,
    /// The episode and tick of the last frame worked on.
    worked: Option<(u32, u32, u64)>,
    gaps_told: u64,
    warmed_term: u32,
    allocation: NewestAllocation,
    /// Its model is another one since the last answer, so that nothing is remembered of the episode.
    is_another: bool,
    /// The newest decision tick whose allocation did not come in time: it is not waited for again.
    given_up: Option<u64>,
    actions: u64,
    presence: Presence,
    counters: Counters,
}

impl RunnerRole {
    /// A runner that has seen nothing yet.
    pub fn new(options: RunnerOptions) -> Self {
        Self {
            options,
            pending: false,
            is_noted: false,
            seen_tick: 0,
            worked: None,
            gaps_told: 0,
            warmed_term: 0,
            allocation: NewestAllocation::default(),
            is_another: false,
            given_up: None,
            actions: 0,
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

    /// The newest tick seen.
    pub fn tick(&self) -> u64 {
        self.seen_tick
    }

    /// From the next frame on it acts for these agents: bit a for agent a. Nobody is told.
    pub fn act_for(&mut self, agents: u64) {
        self.options.agents = agents;
    }

    /// Its model is another one from now on, or the same one loaded anew: the next answers say that it remembers nothing, if
    /// it is one that remembers.
    pub fn change_model(&mut self, model: [u8; 16]) {
        self.options.identity.model = model;
        self.is_another = true;
    }

    /// Takes the seats: announces the runner to the world.
    ///
    /// # Errors
    /// A topic failed.
    pub fn join(&mut self, link: &mut impl AgentLink) -> Result<(), LinkError> {
        self.send_status(link, StatMsg::HELLO)?;
        link.ring(Role::World)
    }

    /// Leaves the seats.
    ///
    /// # Errors
    /// A topic failed.
    pub fn leave(&mut self, link: &mut impl AgentLink) -> Result<(), LinkError> {
        let now = link.now_ns();
        for agent in self.agents() {
            let mut goodbye = self.message(agent, self.seen_tick);
            goodbye.action = NO_ACTION;
            goodbye.flags = ActionMsg::BYE;
            self.send(link, &mut goodbye, now)?;
        }
        self.send_status(link, StatMsg::BYE)?;
        link.ring(Role::World)
    }

    /// Answers the newest frame, once its allocation is there. Without a usable allocation, agents act
    /// unallocated.
    ///
    /// # Errors
    /// A topic failed.
    pub fn poll<P: Policy + ?Sized>(
        &mut self,
        link: &mut impl AgentLink,
        policy: &mut P,
    ) -> Result<Poll, LinkError> {
        self.receive(link)?;
        self.answer(link, policy, None)
    }

    /// As [`Self::poll`]; without a usable allocation, agents act on that of `heuristic`, which has to give
    /// the same one to every runner.
    ///
    /// # Errors
    /// A topic failed.
    pub fn poll_with_heuristic<P: Policy + ?Sized>(
        &mut self,
        link: &mut impl AgentLink,
        policy: &mut P,
        heuristic: &mut dyn Allocator,
    ) -> Result<Poll, LinkError> {
        self.receive(link)?;
        self.answer(link, policy, Some(heuristic))
    }

    /// The generation of the bundle that the frame to be answered asks for, once it has been received.
    pub fn asked_generation(&self, link: &impl AgentLink) -> Option<u16> {
        let frame = link.frame().filter(|_| self.pending)?;
        Some(frame.header.generation)
    }

    /// The second half of [`Self::poll`], which answers what [`Self::receive`] took in: for callers that change policies in
    /// between, by [`Self::asked_generation`].
    ///
    /// # Errors
    /// A topic failed.
    pub fn answer<P: Policy + ?Sized>(
        &mut self,
        link: &mut impl AgentLink,
        policy: &mut P,
        heuristic: Option<&mut dyn Allocator>,
    ) -> Result<Poll, LinkError> {
        let kept = if self.pending { link.frame() } else { None };
        let format = &self.options.format;
        let view = kept.and_then(|Frame { header, payload }| {
            FrameView::checked_before(header, payload, format).ok()
        });
        let Some(view) = view else {
            return self.rest(link);
        };
        let header = view.header();
        if header.has(FrameHeader::SHUTDOWN) {
            return Ok(Poll::Ended);
        }
        if header.kind == FrameKind::WarmUp as u16 {
            self.warm_up(&view, policy);
            return Ok(Poll::Again);
        }
        if header.asks_for_actions() {
            let running_ns = link.now_ns();
            if !core::mem::replace(&mut self.is_noted, true) {
                self.presence.wakes.note(running_ns.saturating_sub(header.t_ns));
            }
            if let Some(until_ns) = self.awaits_allocation(&view, running_ns) {
                return Ok(Poll::Wait { until_ns });
            }
            let is_another = core::mem::take(&mut self.is_another);
            let is_reset = (self.count_gaps(&view) || is_another) && policy.begin_episode();
            let in_force = self.in_force(&view, heuristic);
            let mut answers = Vec::new();
            self.decide(&view, policy, &in_force, (running_ns, link), &mut answers);
            // One time for all: they are sent together.
            let now = link.now_ns();
            self.presence.works.note(now.saturating_sub(running_ns));
            for answer in &mut answers {
                answer.flags |= if is_reset { ActionMsg::STATE_RESET } else { 0 };
                self.send(link, answer, now)?;
            }
            self.pending = false;
            link.ring(Role::World)?;
            return Ok(Poll::Answered);
        }
        self.pass_over(&view);
        self.pending = false;
        Ok(Poll::Again)
    }

    /// Nothing to answer: says now and then that the runner is there.
    fn rest(&mut self, link: &mut impl AgentLink) -> Result<Poll, LinkError> {
        if self.presence.is_due(link.now_ns()) {
            self.send_status(link, 0)?;
        }
        Ok(IDLE)
    }

    /// The first half of [`Self::poll`]: takes in what has arrived, and answers nothing.
    ///
    /// # Errors
    /// A topic failed.
    pub fn receive(&mut self, link: &mut impl AgentLink) -> Result<(), LinkError> {
        if link.receive_frames(&mut |frame| self.accepts(frame))? {
            self.pending = true;
            self.is_noted = false;
        }
        let Self { options, allocation, counters, .. } = self;
        link.receive_allocations(&mut |offered| {
            allocation.offer(offered, &options.format, counters);
        })
    }

    /// Takes frames that are newer than all before; counts the others.
    fn accepts(&mut self, frame: Frame<'_>) -> bool {
        let header = frame.header;
        match self.view(frame) {
            Err(FrameError::Foreign) => self.counters.schema_rejects += 1,
            Err(_) => self.counters.bad_messages += 1,
            Ok(_) if header.kind == FrameKind::WarmUp as u16 => {
                return header.world_term > self.warmed_term && header.tick > self.seen_tick;
            }
            Ok(_) if header.kind != self.options.format.layout.kind() as u16 => {
                self.counters.bad_messages += 1;
            }
            Ok(_) if header.tick <= self.seen_tick => self.counters.old_term_rejects += 1,
            Ok(_) => {
                self.counters.restarts_seen += u64::from(is_next_world(self.seen_tick, header));
                self.seen_tick = header.tick;
                return true;
            }
        }
        false
    }

    fn view<'a>(&self, frame: Frame<'a>) -> Result<FrameView<'a>, FrameError> {
        FrameView::new(frame.header, frame.payload, &self.options.format)
    }

    fn agents(&self) -> impl Iterator<Item = usize> + use<> {
        let mine = self.options.agents & self.options.format.layout.every_agent();
        (0..limits::AGENTS).filter(move |agent| mine >> agent & 1 == 1)
    }

    /// Counts the frames between the last one worked on and this one of the same episode. Returns whether
    /// it is of another episode.
    fn count_gaps(&mut self, view: &FrameView<'_>) -> bool {
        let FrameHeader { world_term, episode, tick, .. } = *view.header();
        let last = self.worked.filter(|(term, last, _)| (*term, *last) == (world_term, episode));
        if let Some((_, _, last_tick)) = last {
            let next = last_tick.saturating_add(1);
            self.counters.frame_gaps += tick.saturating_sub(next);
        }
        self.worked = Some((world_term, episode, tick));
        self.counters.ticks += 1;
        last.is_none()
    }

    /// A frame that asks for nothing, such as a pause, is no gap.
    fn pass_over(&mut self, view: &FrameView<'_>) {
        let FrameHeader { world_term, episode, tick, .. } = *view.header();
        if let Some((term, last, last_tick)) = &mut self.worked
            && (*term, *last) == (world_term, episode)
        {
            *last_tick = tick;
        }
    }

    /// Decides once for every own agent and forgets the decisions.
    fn warm_up<P: Policy + ?Sized>(&mut self, view: &FrameView<'_>, policy: &mut P) {
        let present = view.present();
        let mut seen: Vec<Observation<'_>, { limits::AGENTS }> = Vec::new();
        for agent in self.agents().filter(|&agent| present.contains(agent)) {
            // There is room for every agent.
            let _ = seen.push(view.observation(agent, &view.observable(agent).and(&present)));
        }
        policy.warm();
        policy.decide_batch(&seen, &mut [Err(DecideError::BadLength); limits::AGENTS]);
        self.warmed_term = view.header().world_term;
        self.pending = false;
    }

    fn message(&self, agent: usize, tick: u64) -> ActionMsg {
        ActionMsg {
            schema: self.options.format.schema,
            tick,
            model: self.options.identity.short_model(),
            // The limit of agents fits the field.
            agent: agent as u16,
            task: UNASSIGNED,
            abi: ABI as u8,
            runner: self.options.identity.pid,
            ..ActionMsg::new_zeroed()
        }
    }

    fn send(
        &mut self,
        link: &mut impl AgentLink,
        answer: &mut ActionMsg,
        now_ns: u64,
    ) -> Result<(), LinkError> {
        self.actions += 1;
        answer.seq = self.actions;
        answer.t_ns = now_ns;
        link.send_action(answer)
    }

    fn send_status(&mut self, link: &mut impl AgentLink, flags: u32) -> Result<(), LinkError> {
        let Self { options, counters, .. } = self;
        let domain = (options.format.schema, Role::Runner);
        let now = link.now_ns();
        let told = self.presence.tell(&options.identity, domain, counters, flags, now);
        let agents = options.agents;
        let n_agents = agents.count_ones() as u16;
        link.send_status(&StatMsg { agents, n_agents, last_tick: self.seen_tick, ..told })
    }
}

/// Whether a frame is of a later world than the newest tick seen, if there is one.
pub(super) fn is_next_world(seen_tick: u64, header: &FrameHeader) -> bool {
    seen_tick != 0 && u64::from(header.world_term) > seen_tick >> 32
}
