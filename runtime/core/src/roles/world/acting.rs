//! How a world awaits the actions of a tick, and steps.

use super::report::TickReport;
use super::{Phase, WorldError, WorldObserver, WorldRole};
use crate::limits;
use crate::link::WorldLink;
use crate::policy::NO_ACTION;
use crate::roles::Poll;
use crate::roles::deadlines::allocate_by;
use crate::wire::{ActionMsg, Role};
use crate::world::{StepOutcome, World};

impl WorldRole {
    /// Accepts an answer to the current frame; counts what is late or foreign.
    pub(super) fn take(&mut self, action: &ActionMsg) {
        let agent = usize::from(action.agent);
        if !action.fits(self.options.format.schema) {
            self.counters.schema_rejects += 1;
        } else if agent >= self.options.format.layout.shape().agents {
            self.counters.bad_messages += 1;
        } else if action.has(ActionMsg::BYE) {
            self.seats.leave(agent, action.runner);
        } else if action.tick < self.tick() {
            self.counters.late += 1;
        } else if action.tick > self.tick() || !self.is_possible(agent, action) {
            self.counters.bad_messages += 1;
        } else if self.phase == Phase::Acting && self.may_answer(agent, action.runner) {
            let is_first = self.answered >> agent & 1 == 0;
            if let Some(answer) = self.answers.get_mut(agent).filter(|_| is_first) {
                *answer = *action;
                self.answered |= 1 << agent;
            }
        }
    }

    /// Whether a process acts for this agent in the current tick: one that has just joined does from the next on.
    fn may_answer(&self, agent: usize, process: u32) -> bool {
        if self.filled >> agent & 1 == 1 {
            return process == self.options.identity.pid;
        }
        self.seats.joined() >> agent & 1 == 1
    }

    /// Whether agent, action and subtask exist, and the action is available. A strict world leaves the last to
    /// the world itself, which ends with the agent's name.
    fn is_possible(&self, agent: usize, answer: &ActionMsg) -> bool {
        let shape = self.options.format.layout.shape();
        let is_available =
            || self.available.get(agent).is_some_and(|actions| actions.contains(answer.action));
        let is_action = answer.action == NO_ACTION
            || usize::from(answer.action) < shape.actions
                && (self.options.strict || is_available());
        let is_task = answer.task == crate::UNASSIGNED || usize::from(answer.task) < shape.tasks;
        let is_present = self.present >> agent & 1 == 1;
        is_present && is_action && is_task
    }

    pub(super) fn await_actions<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
        now: u64,
    ) -> Result<Poll, WorldError> {
        self.require_all_seats()?;
        let missing = self.awaited() & !self.answered;
        if missing == 0 {
            self.step(link, world, observer, now)?;
            return Ok(Poll::Again);
        }
        let act_by = if self.deadline_ns == 0 { u64::MAX } else { self.deadline_ns };
        let allocate_by = allocate_by(self.published_ns, self.deadline_ns, self.options.period_ns);
        let is_awaited = self.awaits_allocation();
        if is_awaited && now >= allocate_by {
            if self.options.strict {
                return Err(WorldError::AllocatorMissed { step: self.step });
            }
            if !self.runners_rung {
                self.runners_rung = true;
                link.ring(Role::Runner)?;
            }
        }
        if now >= act_by {
            let seats = missing & self.options.required;
            if self.options.strict && seats != 0 {
                return Err(WorldError::SeatsMissed { step: self.step, seats });
            }
            self.step(link, world, observer, now)?;
            return Ok(Poll::Again);
        }
        let until_ns = if is_awaited && now < allocate_by { allocate_by } else { act_by };
        // Runners ring once after all their answers, the allocator once after an allocation. The last but one wakes
        // the world: while it wakes, the last is still at work.
        let rings = self.seats.holders(missing) + u32::from(is_awaited);
        // What fills seats runs in this process, and acts on any ring.
        link.await_rings(if missing & self.filled == 0 { rings.saturating_sub(1) } else { 1 });
        Ok(Poll::Wait { until_ns })
    }

    /// Whether agents act on an allocation of this tick that has not come yet.
    pub(super) fn awaits_allocation(&self) -> bool {
        let newest = self.allocation.get().map_or(0, |allocation| allocation.tick);
        self.reallocated && !self.options.pipelined && newest < self.decision_tick
    }

    pub(super) fn require_all_seats(&self) -> Result<(), WorldError> {
        if !self.options.strict {
            return Ok(());
        }
        match self.options.required & !self.seats.joined() {
            0 if self.options.allocator && !self.seats.has_leader() => {
                Err(WorldError::AllocatorLeft)
            }
            0 => Ok(()),
            seats => Err(WorldError::SeatsLeft { seats }),
        }
    }

    fn step<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
        running_ns: u64,
    ) -> Result<(), WorldError> {
        let agents = self.options.format.layout.shape().agents;
        let applied = self.applied_actions();
        let actions = applied.get(..agents).unwrap_or_default();
        let outcome = world.step(actions).map_err(WorldError::Unavailable)?;
        self.counters.ticks += 1;
        self.note_unallocated();
        self.watch_leader();
        let now = link.now_ns();
        self.note_times(running_ns, now);
        let interval_ns = self.interval_ns();
        let next_ns = self.due_ns.saturating_add(interval_ns);
        self.timing.overran = interval_ns != 0 && now > next_ns;
        observer.tick(&self.report(actions, outcome, now));
        let acted = self.answered | self.filled;
        let (tick, before) = (self.tick(), self.seats.absent());
        self.seats.note_answers(self.present, acted, self.options.absent_after);
        let newly = self.seats.absent() & !before;
        let since = self.absent_since.iter_mut().enumerate();
        for (_, since) in since.filter(|(agent, _)| newly >> agent & 1 == 1) {
            *since = tick;
        }
        self.last_actions = applied;
        self.step += 1;
        self.allocate_next |= outcome.tasks_changed;
        self.phase = Phase::Pacing { until_ns: next_ns };
        if outcome.episode_ended {
            self.end_episode(link, world, observer)?;
        }
        Ok(())
    }

    /// Notes how long the world took to run after the last answer, if there was one, and to step.
    fn note_times(&mut self, running_ns: u64, now_ns: u64) {
        let answers = self.answers.iter().enumerate();
        let mut answers = answers.filter(|(agent, _)| self.answered >> agent & 1 == 1);
        let first = answers.next().map(|(_, answer)| answer.t_ns);
        if let Some(first) = first {
            let last = answers.fold(first, |last, (_, answer)| last.max(answer.t_ns));
            self.presence.wakes.note(running_ns.saturating_sub(last));
        }
        self.presence.works.note(now_ns.saturating_sub(running_ns));
    }

    /// The answers, and the fallback for present agents for which nobody acts.
    fn applied_actions(&mut self) -> [u16; limits::AGENTS] {
        let agents = self.options.format.layout.shape().agents;
        let mut actions = [NO_ACTION; limits::AGENTS];
        let answers = self.answers.iter().zip(self.fallback).zip(&mut self.tasks);
        for (agent, (action, ((answer, fallback), task))) in
            actions.iter_mut().zip(answers).enumerate().take(agents)
        {
            if self.answered >> agent & 1 == 1 {
                *action = answer.action;
                *task = 1u32.checked_shl(u32::from(answer.task)).unwrap_or(0);
            } else if self.present >> agent & 1 == 1 {
                *action = fallback;
                self.counters.fallbacks += 1;
            }
        }
        actions
    }

    /// Notes whether agents act without a usable allocation.
    fn note_unallocated(&mut self) {
        let agents = self.options.format.layout.shape().agents;
        let answers = self.answers.iter().enumerate().take(agents);
        let mut answers = answers.filter(|(agent, _)| self.answered >> agent & 1 == 1);
        let is_unallocated = answers.any(|(_, answer)| answer.has(ActionMsg::NO_ALLOC));
        let since = self.unallocated_since.unwrap_or(self.tick());
        self.unallocated_since = is_unallocated.then_some(since);
    }

    fn report<'a>(
        &'a self,
        actions: &'a [u16],
        outcome: StepOutcome,
        now_ns: u64,
    ) -> TickReport<'a> {
        let newest = self.allocation.get().filter(|newest| newest.tick >= self.tick());
        TickReport {
            tick: self.tick(),
            episode: self.episode,
            step: self.step,
            actions,
            answers: self.answers.get(..actions.len()).unwrap_or_default(),
            answered: self.answered,
            allocation: newest,
            published_ns: self.published_ns,
            tick_ns: now_ns.saturating_sub(self.published_ns),
            timing: self.timing,
            allocations_missed: self.allocations_missed,
            absent: self.seats.absent(),
            degraded: self.is_degraded(),
            outcome,
        }
    }
}
