//! What this machine's own runtime decides on a frame, to compare a device's answer with.

use sortie_core::Policy;
use sortie_core::link::{ActionTx, AllocRx, Bell, Clock, Frame, FrameRx, LinkError, StatTx, Wake};
use sortie_core::roles::{Poll, RunnerOptions, RunnerRole};
use sortie_core::wire::{ActionMsg, AllocMsg, Role, StatMsg};

/// A link that shows one frame and one allocation, and keeps the answer.
struct Alone<'f> {
    frame: Frame<'f>,
    is_shown: bool,
    allocation: Option<AllocMsg>,
    answer: Option<ActionMsg>,
}

/// What a runner of these options answers to a frame by an allocation; nothing where it does not.
pub(crate) fn answer(
    options: RunnerOptions,
    policy: &mut dyn Policy,
    frame: Frame<'_>,
    allocation: Option<AllocMsg>,
) -> Result<Option<ActionMsg>, LinkError> {
    let mut role = RunnerRole::new(options);
    let mut link = Alone { frame, is_shown: false, allocation, answer: None };
    while role.poll(&mut link, policy)? == Poll::Again {}
    Ok(link.answer)
}

impl FrameRx for Alone<'_> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        Ok(!std::mem::replace(&mut self.is_shown, true) && accept(self.frame))
    }

    fn frame(&self) -> Option<Frame<'_>> {
        Some(self.frame)
    }
}

impl AllocRx for Alone<'_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        if let Some(allocation) = self.allocation.take() {
            take(&allocation);
        }
        Ok(())
    }
}

impl ActionTx for Alone<'_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.answer = Some(*action);
        Ok(())
    }
}

impl StatTx for Alone<'_> {
    fn send_status(&mut self, _status: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Bell for Alone<'_> {
    fn token(&self) -> u32 {
        0
    }

    fn wait_until(&mut self, _token: u32, _until_ns: u64) -> Wake {
        Wake::Timeout
    }

    fn ring(&mut self, _role: Role) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Clock for Alone<'_> {
    /// No allocation is waited for any more.
    fn now_ns(&self) -> u64 {
        self.frame.header.deadline_ns
    }
}
