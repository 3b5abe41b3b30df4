//! What a supervisor looks at: processes that it starts and starts again, the leading allocator, itself.

use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};
use sortie_core::link::{Clock, LinkError, StatTx};
use sortie_core::roles::{Counters, Identity, Presence};
use sortie_core::wire::{Role, StatMsg};

use super::RestartPolicy;
use crate::error::Error;
use crate::process_info::BUILD;
use crate::stop::MonotonicClock;

/// First pause before a process that ended at once is started again; doubled each time.
const FIRST_PAUSE: Duration = Duration::from_millis(1);
/// Longest such pause.
const LONGEST_PAUSE: Duration = Duration::from_millis(64);
/// Pause before the next try where another process has the role.
const BUSY_PAUSE: Duration = Duration::from_secs(1);
/// Pause between two looks whether a place has become free.
const STANDING_BY: Duration = Duration::from_millis(250);
/// Exit code of a process whose role another one has.
const BUSY: i32 = 75;
/// Exit codes that come back whenever the same program is started in the same way. 141: nobody reads its output.
const LASTING: [i32; 8] = [2, 65, 66, 70, 74, 77, 78, 141];

/// A process to keep alive.
#[derive(Debug)]
pub struct Charge {
    /// What reports call it.
    pub name: String,
    /// What it is.
    pub role: Role,
    /// Bit a: it acts for agent a.
    pub agents: u64,
    /// How it is started, by exec.
    pub command: Command,
}

/// A charge and its process.
pub(super) struct Kept {
    pub(super) charge: Charge,
    state: State,
    /// Times in a row that it ended at once.
    vain: u32,
    /// The process that it stands by behind.
    behind: Option<u64>,
    /// It was started for the world of another supervisor.
    serves_another: bool,
}

enum State {
    Due(Instant),
    Running { child: Child, ended: OwnedFd, since: Instant },
    Over,
}

/// What follows the end of a process.
#[derive(Debug)]
pub(super) enum After {
    /// It has done its work, or is not to be started again.
    Over,
    /// It is started again after this pause.
    Again(Duration),
    /// It cannot go on.
    GiveUp(Error),
}

impl Kept {
    pub(super) fn new(charge: Charge) -> Self {
        Self {
            charge,
            state: State::Due(Instant::now()),
            vain: 0,
            behind: None,
            serves_another: false,
        }
    }

    /// Whether the process is to be started now.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        matches!(self.state, State::Due(at) if at <= now)
    }

    /// Leaves its place to process `pid` for a while. Returns whether that is news.
    pub(super) fn stand_by(&mut self, pid: u64, now: Instant) -> bool {
        self.state = State::Due(now + STANDING_BY);
        self.behind.replace(pid) != Some(pid)
    }

    /// Whether another process has its place.
    pub(super) fn stands_by(&self) -> bool {
        self.behind.is_some()
    }

    /// Starts the process: its id. One that serves the world of another supervisor is to serve this one's as well, once
    /// that one has said goodbye.
    pub(super) fn start(&mut self, now: Instant, serves_another: bool) -> Result<u32, Error> {
        (self.behind, self.serves_another) = (None, serves_another);
        let failed = |source| Error::Spawn { name: self.charge.name.clone(), source };
        let mut child = self.charge.command.spawn().map_err(failed)?;
        let ended = match pidfd_open(Pid::from_child(&child), PidfdFlags::empty()) {
            Ok(ended) => ended,
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                return Err(Error::io("follow", &self.charge.name)(error.into()));
            }
        };
        let pid = child.id();
        self.state = State::Running { child, ended, since: now };
        Ok(pid)
    }

    /// Looks whether the process has ended: its id, how, and what follows.
    pub(super) fn reap(
        &mut self,
        policy: &RestartPolicy,
        now: Instant,
    ) -> Option<(u32, ExitStatus, After)> {
        let State::Running { child, since, .. } = &mut self.state else { return None };
        let status = child.try_wait().ok()??;
        let (pid, lived) = (child.id(), now.saturating_duration_since(*since));
        let after = self.judge(policy, status, lived);
        self.state = match after {
            After::Again(pause) => State::Due(now + pause),
            After::Over | After::GiveUp(_) => State::Over,
        };
        Some((pid, status, after))
    }

    fn judge(&mut self, policy: &RestartPolicy, status: ExitStatus, lived: Duration) -> After {
        let name = || self.charge.name.clone();
        match status.code() {
            Some(0) if self.serves_another => return After::Again(FIRST_PAUSE),
            Some(0) => return After::Over,
            // Nobody carries on without a world.
            _ if policy.never && self.charge.role == Role::World => {
                return After::GiveUp(Error::Child { name: name(), status });
            }
            _ if policy.never => return After::Over,
            Some(BUSY) => return After::Again(BUSY_PAUSE),
            Some(code) if LASTING.contains(&code) => {
                return After::GiveUp(Error::Child { name: name(), status });
            }
            _ => {}
        }
        self.vain = if lived < policy.immediate { self.vain + 1 } else { 0 };
        if self.vain >= policy.give_up_after {
            return After::GiveUp(Error::KeepsDying { name: name(), times: self.vain, status });
        }
        After::Again((FIRST_PAUSE * (1 << self.vain.saturating_sub(1).min(6))).min(LONGEST_PAUSE))
    }

    pub(super) fn pid(&self) -> Option<u32> {
        match &self.state {
            State::Running { child, .. } => Some(child.id()),
            State::Due(_) | State::Over => None,
        }
    }

    /// Readable once the running process has ended.
    pub(super) fn ended(&self) -> Option<&OwnedFd> {
        match &self.state {
            State::Running { ended, .. } => Some(ended),
            State::Due(_) | State::Over => None,
        }
    }

    /// When it is to be started, if it is.
    pub(super) fn due(&self) -> Option<Instant> {
        match self.state {
            State::Due(at) => Some(at),
            State::Running { .. } | State::Over => None,
        }
    }

    pub(super) fn is_over(&self) -> bool {
        matches!(self.state, State::Over)
    }

    /// Sends a signal. A process that is not reaped keeps its id, so nobody else can get it.
    pub(super) fn signal(&self, signal: Signal) {
        if let State::Running { child, .. } = &self.state {
            // It may have ended just now.
            let _ = kill_process(Pid::from_child(child), signal);
        }
    }

    pub(super) fn wait(&mut self) {
        if let State::Running { child, .. } = &mut self.state {
            let _ = child.wait();
        }
        self.state = State::Over;
    }
}

/// Questions that a leader may leave unanswered.
const PATIENCE: u32 = 5;

/// How long it may do so, however fast they come: whoever loads another model stands still, and on a busy machine not for
/// milliseconds.
const STANDSTILL: Duration = Duration::from_secs(1);

/// Counts the allocations asked for since the last one that came.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Vigil {
    answered: u64,
    asked: u64,
    missed: u32,
    /// When the first of the missed ones was asked for.
    since: Option<Instant>,
}

impl Vigil {
    /// An allocation of this tick was seen.
    pub(super) fn answered(&mut self, tick: u64) {
        if tick > self.answered {
            self.answered = tick;
            self.missed = 0;
            self.since = None;
        }
    }

    /// The newest tick that asked for an allocation. Some may have passed unseen: it counts too few.
    pub(super) fn asked(&mut self, decision_tick: u64, now: Instant) {
        if decision_tick > self.asked {
            self.asked = decision_tick;
            if decision_tick > self.answered {
                self.missed += 1;
                self.since.get_or_insert(now);
            }
        }
    }

    /// Whether a leader has had its chances.
    pub(super) fn is_silent(&self, now: Instant) -> bool {
        let silence = self.since.map(|since| now.saturating_duration_since(since));
        self.missed >= PATIENCE && silence.is_some_and(|silence| silence >= STANDSTILL)
    }
}

/// A supervisor's statuses so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OwnStatus(Presence);

impl OwnStatus {
    /// Says hello once, then ten times a second that it is there.
    pub(super) fn tell(
        &mut self,
        link: &mut impl StatTx,
        schema: u64,
        restarts: u64,
    ) -> Result<(), LinkError> {
        let now_ns = MonotonicClock.now_ns();
        if !self.0.is_there() {
            return self.send(link, schema, (StatMsg::HELLO, restarts), now_ns);
        }
        if !self.0.is_due(now_ns) {
            return Ok(());
        }
        self.send(link, schema, (0, restarts), now_ns)
    }

    /// Says goodbye, if it has said hello.
    pub(super) fn leave(&mut self, link: &mut impl StatTx, schema: u64) -> Result<(), LinkError> {
        if !self.0.is_there() {
            return Ok(());
        }
        self.send(link, schema, (StatMsg::BYE, 0), MonotonicClock.now_ns())
    }

    fn send(
        &mut self,
        link: &mut impl StatTx,
        schema: u64,
        (flags, restarts_seen): (u32, u64),
        now_ns: u64,
    ) -> Result<(), LinkError> {
        let identity = Identity::new(std::process::id(), "supervisor");
        let identity = Identity { build: BUILD, ..identity };
        let counters = Counters { restarts_seen, ..Counters::default() };
        let domain = (schema, Role::Supervisor);
        link.send_status(&self.0.tell(&identity, domain, &counters, flags, now_ns))
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn a_long_life_makes_up_for_deaths_at_once() {
        let (role, command) = (Role::Runner, Command::new("true"));
        let mut kept = Kept::new(Charge { name: "a runner".to_owned(), role, agents: 1, command });
        let policy = RestartPolicy { give_up_after: 3, ..RestartPolicy::default() };
        let mut pause = |lived| match kept.judge(&policy, ExitStatus::from_raw(1 << 8), lived) {
            After::Again(pause) => Some(pause.as_millis()),
            After::Over | After::GiveUp(_) => None,
        };
        let (none, long) = (Duration::ZERO, policy.immediate);
        let pauses = [none, none, long, none, none, none].map(&mut pause);
        assert_eq!(pauses, [Some(1), Some(2), Some(1), Some(1), Some(2), None]);
    }

    #[test]
    fn a_leader_is_silent_after_five_questions_and_a_second_without_an_answer() {
        let (mut vigil, start) = (Vigil::default(), Instant::now());
        let at = |millis| start + Duration::from_millis(millis);
        for tick in [4, 8, 12, 12, 12, 16] {
            vigil.asked(tick, start);
        }
        assert!(!vigil.is_silent(at(5_000)), "four questions");
        vigil.answered(12);
        for tick in [20, 24, 28, 32] {
            vigil.asked(tick, at(6_000));
            vigil.answered(12);
        }
        assert!(!vigil.is_silent(at(9_000)));
        vigil.asked(36, at(6_500));
        assert_eq!([6_999, 7_000].map(|millis| vigil.is_silent(at(millis))), [false, true]);
        vigil.answered(36);
        assert!(!vigil.is_silent(at(9_000)));
    }
}
