//! The world: publishes a frame per tick, waits for the actions, steps.

mod acting;
mod action_mask;
mod command;
mod frames;
mod report;
mod seats;

pub use report::{TickReport, Timing, WorldError, WorldObserver};

use zerocopy::FromZeros;

use self::action_mask::ActionMask;
use self::command::{Chances, Orders};
use self::seats::Seats;
use super::newest_allocation::NewestAllocation;
use super::presence::Presence;
use super::{Counters, Identity, Poll};
use crate::limits;
use crate::link::{LinkError, WorldLink};
use crate::policy::NO_ACTION;
use crate::wire::{ActionMsg, FrameFormat, FrameHeader, FrameKind, Role, StatMsg};
use crate::world::World;

/// Warm-up frames before the first tick.
const WARM_UP_FRAMES: usize = 8;

/// What a world process is started with.
#[derive(Clone, Copy, Debug)]
pub struct WorldOptions {
    /// The domain's frames.
    pub format: FrameFormat,
    /// Who this is.
    pub identity: Identity,
    /// Leadership term, larger than that of every earlier world of the domain; not 0.
    pub term: u32,
    /// Bit a: the first episode waits until a process acts for agent a.
    pub required: u64,
    /// Whether an allocator is waited for and asked.
    pub allocator: bool,
    /// Whether the world ends when a required seat, or the allocator, leaves or misses its time. Otherwise
    /// nothing ends it: agents for which nobody acts play the fallback action.
    pub strict: bool,
    /// Whether agents act on the allocation of an earlier tick while a new one is computed.
    pub pipelined: bool,
    /// Longest wait for the required seats and the allocator before the first episode, which a world that
    /// is not strict then starts without them.
    pub join_patience_ns: u64,
    /// Time from frame to frame, of which agents get 80 % to act and the allocator 35 %. 0 = none: a
    /// tick takes as long as the team.
    pub period_ns: u64,
    /// Without a period, the longest wait for actions; for allocations half of it. 0 = no limit, for
    /// lock-step in one thread.
    pub patience_ns: u64,
    /// An agent for which nobody acts in so many ticks in a row is absent: frames say so, and allocators leave it out.
    pub absent_after: u32,
    /// Bit a: agent a is absent from the first tick on, until somebody acts for it. No seat of these is required.
    pub absent: u64,
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
    /// Stands still.
    Paused,
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
    /// Generation of the bundle that all decide by.
    generation: u16,
    decision_tick: u64,
    allocation: NewestAllocation,
    allocations_missed: u32,
    /// First of the ticks in a row in which agents acted without a usable allocation.
    unallocated_since: Option<u64>,
    /// The tick after which each absent agent became so; 0 where it was so from the beginning.
    absent_since: [u64; limits::AGENTS],
    /// When the current frame was to be published, how that was kept to, and when it was.
    due_ns: u64,
    timing: Timing,
    published_ns: u64,
    /// Until when actions count for it; 0 = for ever.
    deadline_ns: u64,
    reallocated: bool,
    /// The runners have been woken for it.
    runners_rung: bool,
    /// Bit a: agent a exists in the current frame.
    present: u64,
    /// Bit a: the world's own process acts for agent a in the current frame, whom no other acts for.
    filled: u64,
    /// Bit a: agent a has answered the current frame.
    answered: u64,
    answers: [ActionMsg; limits::AGENTS],
    fallback: [u16; limits::AGENTS],
    available: [ActionMask; limits::AGENTS],
    last_actions: [u16; limits::AGENTS],
    tasks: [u32; limits::AGENTS],
    orders: Orders,
    chances: Chances,
    presence: Presence,
    counters: Counters,
}

impl WorldRole {
    /// A world before its first episode.
    pub fn new(options: WorldOptions) -> Self {
        let absent = options.absent & options.format.layout.every_agent();
        Self {
            options: WorldOptions { required: options.required & !absent, ..options },
            phase: Phase::New,
            seats: Seats::without(absent),
            seq: 0,
            count: 0,
            episode: 0,
            step: 0,
            episodes_done: 0,
            allocate_next: true,
            generation: 0,
            decision_tick: 0,
            allocation: NewestAllocation::default(),
            allocations_missed: 0,
            unallocated_since: None,
            absent_since: [0; limits::AGENTS],
            due_ns: 0,
            timing: Timing::default(),
            published_ns: 0,
            deadline_ns: 0,
            reallocated: false,
            runners_rung: false,
            present: 0,
            filled: 0,
            answered: 0,
            answers: [ActionMsg::new_zeroed(); limits::AGENTS],
            fallback: [NO_ACTION; limits::AGENTS],
            available: [ActionMask::default(); limits::AGENTS],
            last_actions: [NO_ACTION; limits::AGENTS],
            tasks: [0; limits::AGENTS],
            orders: Orders::default(),
            chances: Chances::default(),
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

    /// The tick of the newest frame.
    pub fn tick(&self) -> u64 {
        u64::from(self.options.term) << 32 | u64::from(self.count)
    }

    /// Bit a: a process acts for agent a.
    pub fn joined(&self) -> u64 {
        self.seats.joined()
    }

    /// Bit a: nobody acts for agent a, and has not for so long that allocators leave it out.
    pub fn absent(&self) -> u64 {
        self.seats.absent()
    }

    /// The tick after which an agent became absent; 0 where it was so from the beginning. `None`: it is not.
    pub fn absent_since(&self, agent: usize) -> Option<u64> {
        self.absent_since.get(agent).copied().filter(|_| self.absent() >> agent & 1 == 1)
    }

    /// Takes answers of the world's own process for the agents for which no other acts: [`Self::filled`] says for
    /// which. Nobody needs to join then, and nobody is absent.
    pub fn fill_free_seats(&mut self) {
        self.seats.fill();
        self.options.required = 0;
    }

    /// Bit a: the world's own process is to act for agent a in the current frame, if there is such an agent.
    pub fn filled(&self) -> u64 {
        self.filled
    }

    /// Bit a: somebody is to answer the current frame for agent a.
    fn awaited(&self) -> u64 {
        self.present & (self.seats.joined() | self.filled)
    }

    /// Whether agents have acted without a usable allocation for longer than its grace.
    pub fn is_degraded(&self) -> bool {
        let grace = 2 * u64::from(self.options.decision_interval);
        self.unallocated_since.is_some_and(|since| self.tick().saturating_sub(since) > grace)
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
        if self.is_told_to_end() {
            self.shut_down(link, world)?;
            return Ok(Poll::Ended);
        }
        self.receive(link, observer)?;
        let polled = self.go_on(link, world, observer)?;
        // Others are waited for: nobody waits for this.
        if polled != Poll::Again && self.presence.is_due(link.now_ns()) {
            self.send_status(link, 0)?;
        }
        Ok(polled)
    }

    fn go_on<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) -> Result<Poll, WorldError> {
        let now = link.now_ns();
        match self.phase {
            Phase::New => {
                self.send_status(link, StatMsg::HELLO)?;
                let until_ns = now.saturating_add(self.options.join_patience_ns);
                self.phase = Phase::Joining { until_ns };
                Ok(Poll::Again)
            }
            Phase::Joining { until_ns } => self.gather(link, world, observer, now, until_ns),
            Phase::Pacing { until_ns } => {
                self.require_all_seats()?;
                if let Some(obeyed) = self.obey(link, world, observer)? {
                    return Ok(obeyed);
                }
                if now < until_ns {
                    return Ok(Poll::Wait { until_ns });
                }
                self.keep_time(until_ns, now);
                self.publish_tick(link, world)?;
                Ok(Poll::Again)
            }
            Phase::Acting => match self.is_observed_anew() {
                true => Ok(self.ask_again(now)),
                false => self.await_actions(link, world, observer, now),
            },
            Phase::Paused if self.is_paused() => Ok(super::IDLE),
            Phase::Paused => Ok(self.ask_again(now)),
            Phase::Ended => Ok(Poll::Ended),
        }
    }

    /// Notes how late the next frame is. One that is late by less than the period changes nothing about those after it.
    fn keep_time(&mut self, due_ns: u64, now: u64) {
        let delay_ns = now.saturating_sub(due_ns);
        self.due_ns = if delay_ns < self.options.period_ns { due_ns } else { now };
        self.timing = match delay_ns.checked_div(self.interval_ns()) {
            None => Timing::default(),
            Some(skipped) => Timing { delay_ns, skipped, overran: false },
        };
        let Counters { longest_delay_ns, skipped_periods, .. } = &mut self.counters;
        *longest_delay_ns = (*longest_delay_ns).max(self.timing.delay_ns);
        *skipped_periods += self.timing.skipped;
    }

    /// Time from frame to frame; 0 = as long as the team takes.
    fn interval_ns(&self) -> u64 {
        self.options.period_ns.max(self.options.tick_interval_ns)
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
            self.send_status(link, StatMsg::BYE)?;
        }
        Ok(())
    }

    /// A world leads: its lock made it the only one.
    fn send_status(&mut self, link: &mut impl WorldLink, flags: u32) -> Result<(), LinkError> {
        let degraded = if self.is_degraded() { StatMsg::DEGRADED } else { 0 };
        let flags = flags | StatMsg::LEADER | degraded;
        let (last_tick, now) = (self.tick(), link.now_ns());
        let Self { options, counters, presence, .. } = self;
        counters.restarts_seen = self.seats.restarts();
        let domain = (options.format.schema, Role::World);
        let told = presence.tell(&options.identity, domain, counters, flags, now);
        link.send_status(&StatMsg { last_tick, ..told })
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
        let mut is_answered = false;
        let Self { options, allocation, counters, .. } = self;
        link.receive_allocations(&mut |offered| {
            if allocation.offer(offered, &options.format, counters) {
                is_answered = true;
                observer.allocated(offered);
            }
        })?;
        if is_answered {
            self.leader_answered();
        }
        self.allocate_next |= self.seats.take_changed();
        Ok(())
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
        let allocator = self.options.allocator && !self.seats.has_leader();
        let is_over = now >= until_ns;
        if is_over && self.options.strict && (seats != 0 || allocator) {
            return Err(WorldError::NotJoined { seats, allocator });
        }
        if is_over || seats == 0 && !allocator {
            self.start_episode(world, observer);
            for _ in 0..WARM_UP_FRAMES {
                self.publish(link, world, FrameKind::WarmUp, 0)?;
                link.ring(Role::Runner)?;
            }
            self.phase = Phase::Pacing { until_ns: now };
            return Ok(Poll::Again);
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

    fn end_episode<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) -> Result<(), WorldError> {
        self.count += 1;
        self.publish_between_ticks(link, world, FrameHeader::EPISODE_END)?;
        observer.episode_ended(self.episode, self.step);
        self.episodes_done += 1;
        if self.options.episodes.is_some_and(|episodes| self.episodes_done >= episodes) {
            return self.shut_down(link, world);
        }
        self.begin_next_episode(world, observer);
        Ok(())
    }

    fn begin_next_episode<W: World + ?Sized>(
        &mut self,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) {
        self.episode = self.episode.wrapping_add(1);
        self.start_episode(world, observer);
    }
}

fn ring_all(link: &mut impl WorldLink) -> Result<(), LinkError> {
    link.ring(Role::Allocator)?;
    link.ring(Role::Runner)
}
