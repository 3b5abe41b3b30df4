//! What a world tells its onlooker, and why it ends.

use crate::link::LinkError;
use crate::wire::{ActionMsg, AllocMsg, StatMsg};
use crate::world::{StepOutcome, UnavailableAction};

/// One tick, after its step.
#[derive(Clone, Copy, Debug)]
pub struct TickReport<'a> {
    /// `world_term << 32` + count.
    pub tick: u64,
    /// Episode, from 0.
    pub episode: u32,
    /// Step in the episode, from 0.
    pub step: u32,
    /// The actions applied `[A]`.
    pub actions: &'a [u16],
    /// The agents' messages `[A]`, valid where `answered` says so. Their `t_ns` less
    /// `published_ns` is the time from observation to action; `decide_ns` the decision alone.
    pub answers: &'a [ActionMsg],
    /// Bit a: agent a answered; others are absent, or played the fallback action.
    pub answered: u64,
    /// The allocation made for this tick, if it asked for one.
    pub allocation: Option<&'a AllocMsg>,
    /// Time of the frame's publishing.
    pub published_ns: u64,
    /// From the frame's publishing to the end of the world's step.
    pub tick_ns: u64,
    /// How the tick kept to the rate.
    pub timing: Timing,
    /// Allocations asked for, one after the other, since the last one came. A leader that leaves three
    /// unanswered is to step down.
    pub allocations_missed: u32,
    /// Bit a: nobody acts for agent a, and allocators leave it out: as its frame said, which the step does not change.
    pub absent: u64,
    /// Agents have acted without a usable allocation for longer than its grace.
    pub degraded: bool,
    /// What the step did.
    pub outcome: StepOutcome,
}

/// How a tick kept to the rate that its world is held to; zeros where it is held to none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// From the time at which the frame was due to its publishing.
    pub delay_ns: u64,
    /// Whole periods in that time: frames that should have come and never will.
    pub skipped: u64,
    /// The step ended after the next frame was due.
    pub overran: bool,
}

impl<'a> TickReport<'a> {
    /// The messages of the agents that answered.
    pub fn answers(&self) -> impl Iterator<Item = &'a ActionMsg> + use<'a> {
        let answered = self.answered;
        self.answers
            .iter()
            .enumerate()
            .filter(move |(agent, _)| answered >> agent & 1 == 1)
            .map(|(_, answer)| answer)
    }
}

/// Watches a world. Called between two ticks of the hot loop: keep it short.
pub trait WorldObserver {
    /// A process said that it is there, or goodbye.
    fn status(&mut self, _status: &StatMsg) {}

    /// An episode starts; the world has just been reset.
    fn episode_started(&mut self, _episode: u32) {}

    /// A new allocation arrived.
    fn allocated(&mut self, _allocation: &AllocMsg) {}

    /// A tick is done.
    fn tick(&mut self, _report: &TickReport<'_>) {}

    /// An episode ended after `steps` steps; the world still shows its end.
    fn episode_ended(&mut self, _episode: u32, _steps: u32) {}
}

/// Nobody watches.
impl WorldObserver for () {}

/// Why a world ends before its last episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum WorldError {
    /// A topic failed.
    Link(LinkError),
    /// Required processes did not come in time.
    NotJoined {
        /// Bit a: nobody acts for agent a.
        seats: u64,
        /// There is no allocator.
        allocator: bool,
    },
    /// Processes of required seats left.
    SeatsLeft {
        /// Bit a: nobody acts for agent a any more.
        seats: u64,
    },
    /// The allocator left.
    AllocatorLeft,
    /// Agents did not act in time.
    SeatsMissed {
        /// Step in the episode.
        step: u32,
        /// Bit a: agent a did not act.
        seats: u64,
    },
    /// The allocator did not allocate in time.
    AllocatorMissed {
        /// Step in the episode.
        step: u32,
    },
    /// The world refused an action.
    Unavailable(UnavailableAction),
    /// This term has no ticks left; a restarted world has a new one.
    TicksExhausted,
}

impl From<LinkError> for WorldError {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

impl core::fmt::Display for WorldError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Link(error) => write!(f, "{error}"),
            Self::NotJoined { seats: 0, .. } => f.write_str("no allocator has joined"),
            Self::NotJoined { seats, allocator } => {
                write!(f, "nobody has joined for {}", Agents(seats))?;
                if allocator { f.write_str(", nor as the allocator") } else { Ok(()) }
            }
            Self::SeatsLeft { seats } => write!(f, "the runner of {} left", Agents(seats)),
            Self::AllocatorLeft => f.write_str("the allocator left"),
            Self::SeatsMissed { step, seats } => {
                write!(f, "{} did not act in time at step {step}", Agents(seats))
            }
            Self::AllocatorMissed { step } => {
                write!(f, "the allocator did not allocate in time at step {step}")
            }
            Self::Unavailable(UnavailableAction { agent, action }) => {
                write!(f, "agent {agent} chose action {action}, which is not available")
            }
            Self::TicksExhausted => f.write_str("the world has used all its ticks: start it again"),
        }
    }
}

impl core::error::Error for WorldError {}

/// A set of agents, written as a list.
struct Agents(u64);

impl core::fmt::Display for Agents {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let mut agents = (0..u64::BITS).filter(|agent| self.0 >> agent & 1 == 1);
        match agents.next() {
            Some(first) if self.0.count_ones() == 1 => write!(f, "agent {first}")?,
            Some(first) => write!(f, "agents {first}")?,
            None => f.write_str("no agent")?,
        }
        agents.try_for_each(|agent| write!(f, ", {agent}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn names_every_agent_that_failed() {
        let error = WorldError::SeatsMissed { step: 7, seats: 0b1010 };
        assert_eq!(error.to_string(), "agents 1, 3 did not act in time at step 7");
    }
}
