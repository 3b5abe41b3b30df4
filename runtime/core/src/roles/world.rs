//! The world: publishes a frame per tick, waits for the actions, steps.

mod frames;
mod report;
mod seats;

pub use report::{TickReport, WorldError, WorldObserver};

use zerocopy::FromZeros;

use self::seats::Seats;
use super::newest_allocation::NewestAllocation;
use super::{Counters, Poll};
use crate::limits;
use crate::link::{LinkError, WorldLink};
use crate::policy::NO_ACTION;
use crate::wire::{ActionMsg, FrameFormat, FrameHeader, FrameKind, Role};
use crate::world::{StepOutcome, World};

/// Warm-up frames before the first tick.
const WARM_UP_FRAMES: usize = 8;

/// What a world process is started with.
#[derive(Clone, Copy, Debug)]
pub struct WorldOptions {
    /// The domain's frames.
    pub format: FrameFormat,
    /// Leadership term, larger than that of every earlier world of the domain; not 0.
    pub term: u32,
    /// Bit a: no episode starts before a process acts for agent a, and none goes on without it.
    /// Agents of other seats play the fallback action while nobody acts for them.
    pub required: u64,
    /// Whether an allocator is waited for and asked.
    pub allocator: bool,
    /// Longest wait for the required seats and the allocator before the first episode.
    pub join_patience_ns: u64,
    /// Longest wait for actions; for allocations half of it. 0 = no limit, for lock-step in one
    /// thread.
    pub patience_ns: u64,
    /// Ticks between two allocations.
    pub decision_interval: u32,
    /// The contract's safe action.
    pub safe_action: Option<u16>,
    /// Episodes to run; `None` = until stopped.
    pub episodes: Option<u32>,
    /// Shortest time between two frames, for onlookers. 0 = as fast as the team acts.
    pub tick_interval_ns: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Not polled yet.
    New,
    /// Waits for seats and allocator.
    Joining {
        until_ns: u64,
    },
    /// Waits until the next frame is due.
    Pacing {
        until_ns: u64,
    },
    /// Waits for actions.
    Acting,
    Ended,
}

/// The world as a state machine.
pub struct WorldRole {
    options: WorldOptions,
    phase: Phase,
    seats: Seats,
    seq: u64,
    count: u32,
    episode: u32,
    step: u32,
    episodes_done: u32,
    /// The next frame asks for an allocation whatever its tick.
    allocate_next: bool,
    decision_tick: u64,
    allocation: NewestAllocation,
    published_ns: u64,
    reallocated: bool,
    /// Bit a: agent a exists in the current frame.
    present: u64,
    /// Bit a: agent a has answered the current frame.
    answered: u64,
    answers: [ActionMsg; limits::AGENTS],
    fallback: [u16; limits::AGENTS],
    last_actions: [u16; limits::AGENTS],
    tasks: [u32; limits::AGENTS],
    counters: Counters,
}

impl WorldRole {
    /// A world before its first episode.
    pub fn new(options: WorldOptions) -> Self {
        Self {
            options,
            phase: Phase::New,
            seats: Seats::default(),
            seq: 0,
            count: 0,
            episode: 0,
            step: 0,
            episodes_done: 0,
            allocate_next: true,
            decision_tick: 0,
            allocation: NewestAllocation::default(),
            published_ns: 0,
            reallocated: false,
            present: 0,
            answered: 0,
            answers: [ActionMsg::new_zeroed(); limits::AGENTS],
            fallback: [NO_ACTION; limits::AGENTS],
            last_actions: [NO_ACTION; limits::AGENTS],
            tasks: [0; limits::AGENTS],
            counters: Counters::default(),
        }
    }

    /// What it has counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Bit a: a process acts for agent a.
    pub fn joined(&self) -> u64 {
        self.seats.joined()
    }

    /// Takes in what has arrived and goes on as far as it can.
    ///
    /// # Errors
    /// See [`WorldError`]. The caller ends with [`Self::shut_down`] in any case.
    pub fn poll<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) -> Result<Poll, WorldError> {
        self.receive(link, observer)?;
        let now = link.now_ns();
        match self.phase {
            Phase::New => {
                let until_ns = now.saturating_add(self.options.join_patience_ns);
                self.phase = Phase::Joining { until_ns };
                Ok(Poll::Again)
            }
            Phase::Joining { until_ns } => self.gather(link, world, observer, now, until_ns),
            Phase::Pacing { until_ns } => {
                self.require_all_seats()?;
                if now < until_ns {
                    return Ok(Poll::Wait { until_ns });
                }
                self.publish_tick(link, world)?;
                Ok(Poll::Again)
            }
            Phase::Acting => self.await_actions(link, world, observer, now),
            Phase::Ended => Ok(Poll::Ended),
        }
    }

    /// Tells runners and allocator to end.
    ///
    /// # Errors
    /// The frame could not be sent.
    pub fn shut_down<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &W,
    ) -> Result<(), WorldError> {
        if self.phase != Phase::Ended {
            self.phase = Phase::Ended;
            self.count += 1;
            self.publish(link, world, FrameKind::World, FrameHeader::SHUTDOWN)?;
            ring_all(link)?;
        }
        Ok(())
    }

    fn tick(&self) -> u64 {
        u64::from(self.options.term) << 32 | u64::from(self.count)
    }

    fn receive(
        &mut self,
        link: &mut impl WorldLink,
        observer: &mut dyn WorldObserver,
    ) -> Result<(), LinkError> {
        let Self { options, seats, counters, .. } = self;
        let schema = options.format.schema;
        if self.phase != Phase::Acting {
            link.receive_statuses(&mut |status| {
                if status.fits(schema) {
                    seats.note(status);
                    observer.status(status);
                } else {
                    counters.schema_rejects += 1;
                }
            })?;
        }
        link.receive_actions(&mut |action| self.take(action))?;
        // After the actions: an allocation that they were chosen by has then arrived as well.
        let Self { options, allocation, counters, .. } = self;
        link.receive_allocations(&mut |offered| {
            if allocation.offer(offered, &options.format, counters) {
                observer.allocated(offered);
            }
        })?;
        self.allocate_next |= self.seats.take_changed();
        Ok(())
    }

    /// Accepts an answer to the current frame; counts what is late or foreign.
    fn take(&mut self, action: &ActionMsg) {
        let shape = self.options.format.layout.shape();
        let agent = usize::from(action.agent);
        if !action.fits(self.options.format.schema) {
            self.counters.schema_rejects += 1;
        } else if agent >= shape.agents {
            self.counters.bad_messages += 1;
        } else if action.has(ActionMsg::BYE) {
            self.seats.leave(agent, action.runner);
        } else if action.tick < self.tick() {
            self.counters.late += 1;
        } else if action.tick > self.tick() || !is_valid(action, shape.actions, shape.tasks) {
            self.counters.bad_messages += 1;
        } else if self.phase == Phase::Acting && self.seats.joined() >> agent & 1 == 1 {
            let is_first = self.answered >> agent & 1 == 0;
            if let Some(answer) = self.answers.get_mut(agent).filter(|_| is_first) {
                *answer = *action;
                self.answered |= 1 << agent;
            }
        }
    }

    fn gather<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
        now: u64,
        until_ns: u64,
    ) -> Result<Poll, WorldError> {
        let seats = self.options.required & !self.seats.joined();
        let allocator = self.options.allocator && !self.seats.has_allocator();
        if seats == 0 && !allocator {
            self.start_episode(world, observer);
            for _ in 0..WARM_UP_FRAMES {
                self.publish(link, world, FrameKind::WarmUp, 0)?;
                link.ring(Role::Runner)?;
            }
            self.phase = Phase::Pacing { until_ns: now };
            return Ok(Poll::Again);
        }
        if now >= until_ns {
            return Err(WorldError::NotJoined { seats, allocator });
        }
        Ok(Poll::Wait { until_ns })
    }

    fn start_episode<W: World + ?Sized>(
        &mut self,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) {
        world.reset();
        self.step = 0;
        self.allocate_next = true;
        self.last_actions = [NO_ACTION; limits::AGENTS];
        self.tasks = [0; limits::AGENTS];
        observer.episode_started(self.episode);
    }

    fn await_actions<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
        now: u64,
    ) -> Result<Poll, WorldError> {
        self.require_all_seats()?;
        let missing = self.present & self.seats.joined() & !self.answered;
        if missing == 0 {
            self.step(link, world, observer)?;
            return Ok(Poll::Again);
        }
        let (allocate_by, act_by) = match self.options.patience_ns {
            0 => (u64::MAX, u64::MAX),
            patience => (
                self.published_ns.saturating_add(patience / 2),
                self.published_ns.saturating_add(patience),
            ),
        };
        let newest = self.allocation.get().map_or(0, |allocation| allocation.tick);
        let is_unallocated = self.reallocated && newest < self.decision_tick;
        if is_unallocated && now >= allocate_by {
            return Err(WorldError::AllocatorMissed { step: self.step });
        }
        if now >= act_by {
            return Err(WorldError::SeatsMissed { step: self.step, seats: missing });
        }
        Ok(Poll::Wait { until_ns: if is_unallocated { allocate_by } else { act_by } })
    }

    fn require_all_seats(&self) -> Result<(), WorldError> {
        match self.options.required & !self.seats.joined() {
            0 if self.options.allocator && !self.seats.has_allocator() => {
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
    ) -> Result<(), WorldError> {
        let agents = self.options.format.layout.shape().agents;
        let applied = self.applied_actions();
        let actions = applied.get(..agents).unwrap_or_default();
        let outcome = world.step(actions).map_err(WorldError::Unavailable)?;
        self.counters.ticks += 1;
        observer.tick(&self.report(actions, outcome, link.now_ns()));
        self.last_actions = applied;
        self.step += 1;
        self.allocate_next |= outcome.tasks_changed;
        self.phase = Phase::Pacing {
            until_ns: self.published_ns.saturating_add(self.options.tick_interval_ns),
        };
        if outcome.episode_ended {
            self.end_episode(link, world, observer)?;
        }
        Ok(())
    }

    /// The answers, and the fallback for present agents for which nobody acts.
    fn applied_actions(&mut self) -> [u16; limits::AGENTS] {
        let mut actions = [NO_ACTION; limits::AGENTS];
        let answers = self.answers.iter().zip(self.fallback).zip(&mut self.tasks);
        for (agent, (action, ((answer, fallback), task))) in
            actions.iter_mut().zip(answers).enumerate()
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
            outcome,
        }
    }

    fn end_episode<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) -> Result<(), WorldError> {
        self.count += 1;
        let paced = self.phase;
        self.publish(link, world, FrameKind::World, FrameHeader::EPISODE_END)?;
        self.phase = paced;
        observer.episode_ended(self.episode, self.step);
        self.episodes_done += 1;
        if self.options.episodes.is_some_and(|episodes| self.episodes_done >= episodes) {
            return self.shut_down(link, world);
        }
        self.episode = self.episode.wrapping_add(1);
        self.start_episode(world, observer);
        Ok(())
    }
}

fn is_valid(action: &ActionMsg, actions: usize, tasks: usize) -> bool {
    let action_exists = action.action == NO_ACTION || usize::from(action.action) < actions;
    let task_exists = action.task == crate::UNASSIGNED || usize::from(action.task) < tasks;
    action_exists && task_exists
}

fn ring_all(link: &mut impl WorldLink) -> Result<(), LinkError> {
    link.ring(Role::Allocator)?;
    link.ring(Role::Runner)
}
