//! A runner's link that notes the actions which go over it.

use sortie_core::link::{
    ActionTx, AllocRx, Bell, Clock, DirectAgent, Frame, FrameRx, LinkError, StatTx, Wake,
};
use sortie_core::wire::{ActionMsg, AllocMsg, Role, StatMsg};

pub(crate) struct Noted<'a, 'b> {
    link: DirectAgent<'a, 'b>,
    pub(crate) actions: Vec<ActionMsg>,
}

impl<'a, 'b> Noted<'a, 'b> {
    pub(crate) fn new(link: DirectAgent<'a, 'b>) -> Self {
        Self { link, actions: Vec::new() }
    }
}

impl ActionTx for Noted<'_, '_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.actions.push(*action);
        self.link.send_action(action)
    }
}

impl FrameRx for Noted<'_, '_> {
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

impl AllocRx for Noted<'_, '_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.link.receive_allocations(take)
    }
}

impl StatTx for Noted<'_, '_> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.link.send_status(status)
    }
}

impl Bell for Noted<'_, '_> {
    fn token(&self) -> u32 {
        self.link.token()
    }

    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        self.link.wait_until(token, until_ns)
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.link.ring(role)
    }
}

impl Clock for Noted<'_, '_> {
    fn now_ns(&self) -> u64 {
        self.link.now_ns()
    }
}
