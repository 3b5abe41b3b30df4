//! The simulated link: the traits of every transport over the simulated topics.

use std::rc::Rc;

use sortie_core::link::{
    ActionRx, ActionTx, AllocRx, AllocTx, Bell, Clock, Frame, FrameBlock, FrameRx, FrameTx,
    LinkError, StatRx, StatTx, Wake,
};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};
use zerocopy::IntoBytes;

use super::hosts::Newest;
use super::network::{Network, SentFrame, Shared};

/// One process's end. Once the process is killed, everything fails and nothing leaves.
pub(crate) struct SimulatedLink {
    network: Shared,
    pid: u32,
    payload_blocks: usize,
    kept: Option<Rc<SentFrame>>,
    newest: Option<FrameHeader>,
}

impl SimulatedLink {
    pub(crate) fn open(network: Shared, pid: u32, role: Role, payload_bytes: usize) -> Self {
        network.borrow_mut().open(pid, role);
        let payload_blocks = payload_bytes / size_of::<FrameBlock>();
        Self { network, pid, payload_blocks, kept: None, newest: None }
    }

    /// That of a process on another host, which has none.
    pub(crate) fn none(network: Shared, pid: u32) -> Self {
        Self { network, pid, payload_blocks: 0, kept: None, newest: None }
    }

    /// Does one operation, unless the process is dead.
    fn operate<T>(
        &self,
        failure: LinkError,
        operation: impl FnOnce(&mut Network, u32) -> T,
    ) -> Result<T, LinkError> {
        let mut network = self.network.borrow_mut();
        if network.operates(self.pid) {
            Ok(operation(&mut network, self.pid))
        } else {
            Err(failure)
        }
    }

    /// Takes every waiting message; the network is not borrowed while `take` looks at one.
    fn drain<M>(
        &self,
        failure: LinkError,
        next: impl Fn(&mut Network, u32) -> Option<M>,
        mut take: impl FnMut(M),
    ) -> Result<(), LinkError> {
        while let Some(message) = self.operate(failure, &next)? {
            take(message);
        }
        Ok(())
    }
}

impl FrameRx for SimulatedLink {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        let (mut accepted, mut newest) = (None, None);
        self.drain(LinkError::Frames, Network::next_frame, |sent| {
            newest = Some(sent.header);
            let frame = Frame { header: &sent.header, payload: sent.payload.as_bytes() };
            if accept(frame) {
                accepted = Some(sent);
            }
        })?;
        self.newest = newest.or(self.newest);
        let is_accepted = accepted.is_some();
        if let Some(frame) = &accepted {
            self.network.borrow_mut().oracle.frame_kept(self.pid, &frame.header);
            self.kept = accepted;
        }
        Ok(is_accepted)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        let sent = self.kept.as_ref()?;
        Some(Frame { header: &sent.header, payload: sent.payload.as_bytes() })
    }
}

impl Newest for SimulatedLink {
    fn newest(&self) -> Option<FrameHeader> {
        self.newest
    }
}

impl FrameTx for SimulatedLink {
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError> {
        let mut payload = vec![FrameBlock::zeroed(); self.payload_blocks];
        let header = fill(payload.as_mut_bytes())?;
        let frame = SentFrame { header, payload };
        self.operate(LinkError::Frames, |network, pid| network.send_frame(pid, frame))
    }
}

impl ActionRx for SimulatedLink {
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError> {
        self.drain(LinkError::Actions, Network::next_action, |action| take(&action))
    }
}

impl ActionTx for SimulatedLink {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.operate(LinkError::Actions, |network, pid| network.send_action(pid, action))
    }
}

impl AllocRx for SimulatedLink {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.drain(LinkError::Allocations, Network::next_allocation, |allocation| {
            self.network.borrow_mut().oracle.allocation_seen(self.pid, &allocation);
            take(&allocation);
        })
    }
}

impl AllocTx for SimulatedLink {
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        self.operate(LinkError::Allocations, |network, pid| {
            network.send_allocation(pid, allocation);
        })
    }
}

impl StatRx for SimulatedLink {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        self.drain(LinkError::Statuses, Network::next_status, |status| take(&status))
    }
}

impl StatTx for SimulatedLink {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.operate(LinkError::Statuses, |network, pid| network.send_status(pid, status))
    }
}

impl Bell for SimulatedLink {
    fn token(&self) -> u32 {
        0
    }

    /// The scheduler waits for the processes.
    fn wait_until(&mut self, _token: u32, _until_ns: u64) -> Wake {
        Wake::Timeout
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.operate(LinkError::Bell, |network, pid| network.ring(pid, role))
    }
}

impl Clock for SimulatedLink {
    fn now_ns(&self) -> u64 {
        self.network.borrow().now_ns
    }
}
