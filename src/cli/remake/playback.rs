//! A link that gives a role what a record says it had, and keeps what the role says.

use sortie_core::link::{
    ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameRx, LinkError, StatTx, Wake,
};
use sortie_core::wire::{ActionMsg, AllocMsg, Role, StatMsg};

use super::contents::Shown;

/// Later than anything that a role waits for.
const LATE_NS: u64 = u64::MAX / 2;

/// The link of one role for one decision.
pub(super) struct Playback<'a> {
    frame: &'a Shown,
    /// The role has looked at the frame.
    is_seen: bool,
    allocation: Option<&'a AllocMsg>,
    pub(super) actions: Vec<ActionMsg>,
    pub(super) allocations: Vec<AllocMsg>,
}

impl<'a> Playback<'a> {
    pub(super) fn new(frame: &'a Shown, allocation: Option<&'a AllocMsg>) -> Self {
        let (actions, allocations) = (Vec::new(), Vec::new());
        Self { frame, is_seen: false, allocation, actions, allocations }
    }
}

impl FrameRx for Playback<'_> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        let is_first = !std::mem::replace(&mut self.is_seen, true);
        Ok(is_first && self.frame().is_some_and(accept))
    }

    fn frame(&self) -> Option<Frame<'_>> {
        let Shown { header, payload } = self.frame;
        Some(Frame { header, payload: payload.as_slice() })
    }
}

impl AllocRx for Playback<'_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.allocation.take().into_iter().for_each(take);
        Ok(())
    }
}

impl ActionTx for Playback<'_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.actions.push(*action);
        Ok(())
    }
}

impl AllocTx for Playback<'_> {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        self.allocations.push(*allocation);
        Ok(())
    }
}

impl StatTx for Playback<'_> {
    fn send_status(&mut self, _: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Bell for Playback<'_> {
    fn token(&self) -> u32 {
        0
    }

    fn wait_until(&mut self, _: u32, _: u64) -> Wake {
        Wake::Timeout
    }

    fn ring(&mut self, _: Role) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Clock for Playback<'_> {
    fn now_ns(&self) -> u64 {
        LATE_NS
    }
}
