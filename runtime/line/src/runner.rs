//! A runner whose team is on another host: a role at the far end of a line.

use std::time::Duration;

use sortie_core::Policy;
use sortie_core::link::{AgentLink, Clock, LinkError};
use sortie_core::roles::{Poll, RunnerRole};

use crate::away::{Away, Rest};

/// After so long without a word the line is taken for cut: three ticks, and at least this.
const LEAST_SILENCE: Duration = Duration::from_millis(300);
/// Longest wait for a packet, so that signals are noticed and the team hears of the runner.
const HEARTBEAT_NS: u64 = 100_000_000;

/// A role with its line, polled by whoever drives it.
pub struct FarRunner<'a, L> {
    role: RunnerRole,
    /// A [`Serial`](sortie_core::link::Serial) over the line.
    link: L,
    line: Away,
    rest: &'a Rest,
    /// How long the team may be silent.
    silence: Duration,
    is_cut: bool,
    /// The state of the line before the newest poll: what comes during it wakes.
    token: u32,
}

/// What comes of a poll.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FarPoll {
    /// It has more to do.
    Again,
    /// There is nothing to do until something comes, or this time of its clock.
    Wait {
        /// Nanoseconds.
        until_ns: u64,
    },
    /// Nothing is heard of the team any more: nothing is done. Told once.
    CutOff,
    /// The team is heard again. Told once.
    Heard,
    /// Another end of the team is there, which has to be asked anew.
    Replaced,
    /// The world has ended.
    Ended,
}

impl<'a, L: AgentLink> FarRunner<'a, L> {
    /// Says hello. `link` is over this line, `rest` its processor.
    ///
    /// # Errors
    /// [`LinkError`]: the link failed.
    pub fn join(
        mut role: RunnerRole,
        mut link: L,
        (line, rest): (Away, &'a Rest),
        period_ns: u64,
    ) -> Result<Self, LinkError> {
        role.join(&mut link)?;
        let silence = Duration::from_nanos(period_ns.saturating_mul(3)).max(LEAST_SILENCE);
        Ok(Self { role, link, line, rest, silence, is_cut: false, token: 0 })
    }

    /// Says what is to be said, and does what is to be done.
    ///
    /// # Errors
    /// As [`Self::join`].
    pub fn poll(&mut self, policy: &mut dyn Policy) -> Result<FarPoll, LinkError> {
        self.line.send();
        self.line.hear();
        if self.line.is_replaced() {
            return Ok(FarPoll::Replaced);
        }
        let is_silent = self.line.silence() > self.silence;
        // Who is heard again says so before it acts.
        if is_silent != std::mem::replace(&mut self.is_cut, is_silent) {
            return Ok(if is_silent { FarPoll::CutOff } else { FarPoll::Heard });
        }
        self.token = self.link.token();
        let heartbeat_ns = self.rest.now_ns().saturating_add(HEARTBEAT_NS);
        // Who is cut off acts no more, on what it was shown before neither: its team has gone on.
        if is_silent {
            return Ok(FarPoll::Wait { until_ns: heartbeat_ns });
        }
        match self.role.poll(&mut self.link, policy)? {
            Poll::Ended => Ok(FarPoll::Ended),
            Poll::Again | Poll::Answered => Ok(FarPoll::Again),
            Poll::Wait { until_ns } => {
                self.line.send();
                Ok(FarPoll::Wait { until_ns: until_ns.min(heartbeat_ns) })
            }
        }
    }

    /// Sleeps until something comes, or a time of its clock.
    pub fn wait(&mut self, until_ns: u64) {
        self.rest.until(until_ns);
        self.link.wait_until(self.token, until_ns);
    }

    /// Says goodbye.
    ///
    /// # Errors
    /// As [`Self::join`].
    pub fn leave(&mut self) -> Result<(), LinkError> {
        self.role.leave(&mut self.link)?;
        self.line.send();
        Ok(())
    }

    /// The role.
    pub fn role(&self) -> &RunnerRole {
        &self.role
    }
}
