//! Bugs to be found: what a link with a mistake in it would do to a role.

use sortie_core::UNASSIGNED;
use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameRx, FrameTx, LinkError, StatRx,
    StatTx, Wake,
};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};

use super::hosts::Newest;
use super::link::SimulatedLink;

/// A planted bug.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Planted {
    /// Runners believe whichever allocation came last, whatever its term.
    OldTermAccepted,
    /// Allocators ring before they send.
    WakeUpBeforeData,
    /// Allocators keep the subtask of an agent that has gone.
    DeadAgentKept,
    /// Two processes stand in for the same agents.
    TwoSeats,
    /// Who stands in passes an answer on once more, for the next tick.
    AnswerRestamped,
    /// A runner that is cut off does not say so.
    CutUnsaid,
}

impl Planted {
    /// Whether it is one of lines between hosts.
    pub(crate) fn is_of_hosts(self) -> bool {
        matches!(self, Self::TwoSeats | Self::AnswerRestamped | Self::CutUnsaid)
    }
}

/// What a process with the bug remembers.
#[derive(Default)]
pub(crate) struct Memory {
    /// Term and epoch of every allocation seen; agents are told the place in this list as the epoch.
    seen: Vec<(u32, u32)>,
    last: Option<AllocMsg>,
    answered: Option<ActionMsg>,
}

/// A link with the bug in it.
pub(crate) struct PlantedLink<'a> {
    pub(crate) link: &'a mut SimulatedLink,
    pub(crate) memory: &'a mut Memory,
    pub(crate) bug: Planted,
}

impl AllocRx for PlantedLink<'_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        let Self { link, memory, bug } = self;
        link.receive_allocations(&mut |allocation| {
            let mut shown = *allocation;
            if *bug == Planted::OldTermAccepted {
                memory.seen.push(allocation.order());
                (shown.term, shown.epoch) = (u32::MAX, memory.seen.len() as u32);
            }
            take(&shown);
        })
    }
}

impl ActionTx for PlantedLink<'_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        let mut sent = *action;
        if self.bug == Planted::OldTermAccepted && action.alloc_term == u32::MAX {
            let place = action.alloc_epoch as usize - 1;
            (sent.alloc_term, sent.alloc_epoch) = self.memory.seen[place];
        }
        let before = self.memory.answered.replace(sent);
        if let Some(before) = before
            .filter(|before| self.bug == Planted::AnswerRestamped && before.agent == sent.agent)
        {
            self.link.send_action(&ActionMsg { tick: sent.tick, ..before })?;
        }
        self.link.send_action(&sent)
    }
}

impl AllocTx for PlantedLink<'_> {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        let mut sent = *allocation;
        if self.bug == Planted::WakeUpBeforeData {
            self.link.ring(Role::Runner)?;
            self.link.ring(Role::World)?;
        }
        if let Some(last) = self.memory.last.filter(|_| self.bug == Planted::DeadAgentKept) {
            for (task, last) in sent.task.iter_mut().zip(last.task) {
                *task = if *task == UNASSIGNED { last } else { *task };
            }
        }
        self.memory.last = Some(sent);
        self.link.send_allocation(&sent)
    }
}

impl Bell for PlantedLink<'_> {
    fn token(&self) -> u32 {
        self.link.token()
    }

    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        self.link.wait_until(token, until_ns)
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        let is_rung = self.bug == Planted::WakeUpBeforeData && self.memory.last.is_some();
        if is_rung { Ok(()) } else { self.link.ring(role) }
    }
}

impl FrameRx for PlantedLink<'_> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        self.link.receive_frames(accept)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        self.link.frame()
    }
}

impl Newest for PlantedLink<'_> {
    fn newest(&self) -> Option<FrameHeader> {
        self.link.newest()
    }
}

impl FrameTx for PlantedLink<'_> {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        self.link.send_frame(fill)
    }
}

impl ActionRx for PlantedLink<'_> {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        self.link.receive_actions(take)
    }
}

impl StatRx for PlantedLink<'_> {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        self.link.receive_statuses(take)
    }
}

impl StatTx for PlantedLink<'_> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.link.send_status(status)
    }
}

impl Clock for PlantedLink<'_> {
    fn now_ns(&self) -> u64 {
        self.link.now_ns()
    }
}
