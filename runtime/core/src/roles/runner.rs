//! The runner: acts for one or more agents.

use heapless::Vec;
use zerocopy::FromZeros;

use super::fallback::{fallback_action, safe_action};
use super::newest_allocation::NewestAllocation;
use super::{Counters, IDLE, Identity, Poll};
use crate::allocator::UNASSIGNED;
use crate::limits;
use crate::link::{AgentLink, Clock, Frame, LinkError};
use crate::policy::{DecideError, Decision, NO_ACTION, Observation, Policy, visible};
use crate::wire::{
    ABI, ActionMsg, AllocMsg, FrameError, FrameFormat, FrameHeader, FrameKind, FrameView, Role,
    StatMsg,
};

/// What a runner is started with.
#[derive(Clone, Copy, Debug)]
pub struct RunnerOptions {
    /// The domain's frames.
    pub format: FrameFormat,
    /// Who this is.
    pub identity: Identity,
    /// Bit a: it acts for agent a.
    pub agents: u64,
    /// Whether the policy attends only to its own subtask, and so waits for allocations.
    pub subtasks: bool,
    /// Ticks for which an allocation is meant to hold; after it, twice as many are its grace.
    pub decision_interval: u32,
    /// The contract's safe action.
    pub safe_action: Option<u16>,
}

/// How usable the newest allocation is for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Freshness {
    Fresh,
    Stale,
    None,
}

/// A runner as a state machine.
pub struct RunnerRole {
    options: RunnerOptions,
    /// The frame kept by the link has not been answered.
    pending: bool,
    seen_tick: u64,
    /// The episode and tick of the last frame worked on.
    worked: Option<(u32, u32, u64)>,
    gaps_told: u64,
    warmed_term: u32,
    allocation: NewestAllocation,
    actions: u64,
    statuses: u64,
    counters: Counters,
}

impl RunnerRole {
    /// A runner that has seen nothing yet.
    pub fn new(options: RunnerOptions) -> Self {
        Self {
            options,
            pending: false,
            seen_tick: 0,
            worked: None,
            gaps_told: 0,
            warmed_term: 0,
            allocation: NewestAllocation::default(),
            actions: 0,
            statuses: 0,
            counters: Counters::default(),
        }
    }

    /// What it has counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
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
        for agent in self.agents() {
            let mut goodbye = self.message(agent, self.seen_tick);
            goodbye.action = NO_ACTION;
            goodbye.flags = ActionMsg::BYE;
            self.send(link, goodbye)?;
        }
        self.send_status(link, StatMsg::BYE)?;
        link.ring(Role::World)
    }

    /// Answers the newest frame, once its allocation is there.
    ///
    /// # Errors
    /// A topic failed.
    pub fn poll<P: Policy + ?Sized>(
        &mut self,
        link: &mut impl AgentLink,
        policy: &mut P,
    ) -> Result<Poll, LinkError> {
        self.receive(link)?;
        let kept = if self.pending { link.frame() } else { None };
        let Some(view) = kept.and_then(|frame| self.view(frame).ok()) else {
            return Ok(IDLE);
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
            let until_ns = allocation_deadline(header);
            let is_missing = self.options.subtasks && self.freshness(&view) != Freshness::Fresh;
            if is_missing && link.now_ns() < until_ns {
                return Ok(Poll::Wait { until_ns });
            }
            self.count_gaps(&view);
            let answers = self.decide(&view, policy, link);
            for answer in answers {
                self.send(link, answer)?;
            }
            link.ring(Role::World)?;
        }
        self.pending = false;
        Ok(Poll::Again)
    }

    fn receive(&mut self, link: &mut impl AgentLink) -> Result<(), LinkError> {
        if link.receive_frames(&mut |frame| self.accepts(frame))? {
            self.pending = true;
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
            Ok(_) if header.kind != FrameKind::World as u16 => self.counters.bad_messages += 1,
            Ok(_) if header.tick <= self.seen_tick => self.counters.old_term_rejects += 1,
            Ok(_) => {
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

    fn freshness(&self, view: &FrameView<'_>) -> Freshness {
        let Some(allocation) =
            self.allocation.get().filter(|newest| newest.tick >= view.episode_start())
        else {
            return Freshness::None;
        };
        let grace = 2 * u64::from(self.options.decision_interval);
        if allocation.tick >= view.decision_tick() {
            Freshness::Fresh
        } else if view.header().tick <= allocation.valid_until.saturating_add(grace) {
            Freshness::Stale
        } else {
            Freshness::None
        }
    }

    /// Counts the frames between the last one worked on and this one of the same episode.
    fn count_gaps(&mut self, view: &FrameView<'_>) {
        let FrameHeader { world_term, episode, tick, .. } = *view.header();
        if let Some((term, last_episode, last_tick)) = self.worked
            && (term, last_episode) == (world_term, episode)
        {
            self.counters.frame_gaps += tick.saturating_sub(last_tick + 1);
        }
        self.worked = Some((world_term, episode, tick));
        self.counters.ticks += 1;
    }

    /// Decides once for every own agent and forgets the decisions.
    fn warm_up<P: Policy + ?Sized>(&mut self, view: &FrameView<'_>, policy: &mut P) {
        let present = view.present();
        let agents = self.agents().filter(|&agent| present.contains(agent));
        let seen: Vec<Observation<'_>, { limits::AGENTS }> = agents
            .map(|agent| observation(view, agent, view.observable(agent).and(&present)))
            .collect();
        policy.warm();
        policy.decide_batch(&seen, &mut [Err(DecideError::BadLength); limits::AGENTS]);
        self.warmed_term = view.header().world_term;
        self.pending = false;
    }

    fn decide<P: Policy + ?Sized>(
        &mut self,
        view: &FrameView<'_>,
        policy: &mut P,
        clock: &impl Clock,
    ) -> Vec<ActionMsg, { limits::AGENTS }> {
        let freshness = self.freshness(view);
        let allocation = self.allocation.get().copied().filter(|_| freshness != Freshness::None);
        let flags = self.flags(view, freshness, clock.now_ns());
        let subtasks = self.subtasks(view, allocation.as_ref());
        let present = view.present();
        let mut answers = Vec::new();
        let mut seen: Vec<Observation<'_>, { limits::AGENTS }> = Vec::new();
        let mut deciding = 0_u64;
        for agent in self.agents().filter(|&agent| present.contains(agent)) {
            let mut answer = self.message(agent, view.header().tick);
            answer.flags = flags;
            let task = allocation.and_then(|allocation| allocation.task_of(agent));
            let sees = if self.options.subtasks {
                visible(view.observable(agent), present, &subtasks, task)
            } else {
                view.observable(agent).and(&present)
            };
            // There is room for every agent: one answer and one observation at most.
            if self.options.subtasks && task.is_none() {
                answer.action = safe_action(self.options.safe_action, view.available(agent));
            } else if seen.push(observation(view, agent, sees)).is_ok() {
                deciding |= 1 << agent;
            }
            answer.task = task.unwrap_or(UNASSIGNED);
            answer.alloc_epoch = allocation.map_or(0, |allocation| allocation.epoch);
            answer.alloc_term = allocation.map_or(0, |allocation| allocation.term);
            let _ = answers.push(answer);
        }
        let mut decisions = [Err(DecideError::BadLength); limits::AGENTS];
        let started = clock.now_ns();
        policy.decide_batch(&seen, &mut decisions);
        // Agents decide together; each is told its share of the time.
        let share = clock.now_ns().saturating_sub(started).checked_div(seen.len() as u64);
        let share = u32::try_from(share.unwrap_or(0)).unwrap_or(u32::MAX);
        let acting =
            answers.iter_mut().filter(|answer: &&mut ActionMsg| deciding >> answer.agent & 1 == 1);
        for ((answer, observation), decision) in acting.zip(&seen).zip(decisions) {
            self.act(answer, decision, observation);
            answer.decide_ns = share;
        }
        answers
    }

    fn act(
        &mut self,
        answer: &mut ActionMsg,
        decision: Result<Decision, DecideError>,
        observation: &Observation<'_>,
    ) {
        match decision {
            Ok(decision) => {
                answer.action = decision.action;
                answer.q = decision.utility;
            }
            Err(DecideError::NoAvailableAction) => answer.action = NO_ACTION,
            Err(_) => {
                let last = observation.last_actions.get(observation.self_index);
                let last = last.copied().unwrap_or(NO_ACTION);
                answer.action =
                    fallback_action(last, self.options.safe_action, observation.available);
                answer.flags |= ActionMsg::FALLBACK;
                self.counters.fallbacks += 1;
            }
        }
    }

    fn flags(&mut self, view: &FrameView<'_>, freshness: Freshness, now: u64) -> u16 {
        let mut flags = 0;
        match freshness {
            _ if !self.options.subtasks => {}
            Freshness::Fresh => {}
            Freshness::Stale => {
                flags |= ActionMsg::STALE_ALLOC;
                self.counters.stale_allocations += 1;
            }
            Freshness::None => {
                flags |= ActionMsg::NO_ALLOC;
                self.counters.no_allocations += 1;
            }
        }
        if self.counters.frame_gaps > self.gaps_told {
            flags |= ActionMsg::TICK_GAP;
            self.gaps_told = self.counters.frame_gaps;
        }
        let deadline = view.header().deadline_ns;
        if deadline != 0 && now > deadline {
            flags |= ActionMsg::LATE;
        }
        flags
    }

    /// The frame's subtasks `[N]`, agents' rows overwritten by the allocation.
    fn subtasks(
        &self,
        view: &FrameView<'_>,
        allocation: Option<&AllocMsg>,
    ) -> [u32; limits::ENTITIES] {
        let mut subtasks = [0; limits::ENTITIES];
        for (to, from) in subtasks.iter_mut().zip(view.entity_task()) {
            *to = *from;
        }
        for (agent, to) in subtasks.iter_mut().enumerate().take(view.agents()) {
            let task = allocation.and_then(|allocation| allocation.task_of(agent));
            *to = task.and_then(|task| 1u32.checked_shl(u32::from(task))).unwrap_or(0);
        }
        subtasks
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

    fn send(&mut self, link: &mut impl AgentLink, mut answer: ActionMsg) -> Result<(), LinkError> {
        self.actions += 1;
        answer.seq = self.actions;
        answer.t_ns = link.now_ns();
        link.send_action(&answer)
    }

    fn send_status(&mut self, link: &mut impl AgentLink, flags: u32) -> Result<(), LinkError> {
        self.statuses += 1;
        let agents = self.options.agents;
        let status = StatMsg {
            seq: self.statuses,
            t_ns: link.now_ns(),
            agents,
            n_agents: agents.count_ones() as u16,
            last_tick: self.seen_tick,
            ..self.options.identity.status(self.options.format.schema, Role::Runner, flags)
        };
        link.send_status(&status)
    }
}

/// Until when agents wait for the allocation of a frame: half of the time that the world waits.
fn allocation_deadline(header: &FrameHeader) -> u64 {
    match header.deadline_ns {
        0 => u64::MAX,
        deadline => header.t_ns + deadline.saturating_sub(header.t_ns) / 2,
    }
}

fn observation<'a>(
    view: &FrameView<'a>,
    agent: usize,
    visible: crate::EntityMask,
) -> Observation<'a> {
    Observation {
        rows: view.rows(),
        stride: view.stride(),
        last_actions: view.last_actions(),
        visible,
        self_index: agent,
        available: view.available(agent),
    }
}
