//! A link of which one agent gets its private frames, where world and runner share a process.

use zerocopy::IntoBytes;

use super::{
    ActionTx, AgentLink, AllocRx, Bell, Clock, Frame, FrameBlock, FrameRx, LinkError, StatTx, Wake,
};
use crate::shape::Shape;
use crate::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameLayout, FrameView, LayoutError, Role,
    StatMsg,
};

/// The newest frame as one agent gets it: what this agent sees, and no more.
pub struct PrivateFrames<'m> {
    whole: FrameFormat,
    own: FrameLayout,
    /// The frame that is kept, and the next.
    places: [Place<'m>; 2],
    /// Which of them is kept.
    kept: Option<usize>,
}

struct Place<'m> {
    header: FrameHeader,
    payload: &'m mut [u8],
}

/// A runner's link over one with world frames, of which it keeps what one agent sees.
pub struct PrivateAgent<'a, 'm, L> {
    frames: &'a mut PrivateFrames<'m>,
    link: L,
}

impl<'m> PrivateFrames<'m> {
    /// Those of `agent`, where `whole` is the domain's format. `memory`: as many blocks as [`Self::blocks`] says.
    ///
    /// # Errors
    /// There is no such agent, or the domain has more entities than private frames have rows for.
    pub fn new(
        whole: &FrameFormat,
        agent: usize,
        memory: &'m mut [FrameBlock],
    ) -> Result<Self, LayoutError> {
        let own = FrameLayout::private(whole.layout.shape(), agent)?;
        let bytes = memory.as_mut_bytes();
        let half = own.payload_bytes().min(bytes.len());
        let (one, rest) = bytes.split_at_mut_checked(half).unwrap_or_default();
        let half = half.min(rest.len());
        let (other, _) = rest.split_at_mut_checked(half).unwrap_or_default();
        let place = |payload| Place { header: FrameHeader::default(), payload };
        Ok(Self { whole: *whole, own, places: [place(one), place(other)], kept: None })
    }

    /// Blocks of memory for a domain of this shape.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn blocks(shape: Shape) -> Result<usize, LayoutError> {
        let bytes = FrameLayout::private(shape, 0)?.payload_bytes();
        Ok(2 * bytes / size_of::<FrameBlock>())
    }

    /// What they look like, for the runner's role.
    pub fn format(&self) -> FrameFormat {
        FrameFormat { layout: self.own, ..self.whole }
    }

    /// The agent's link over `link`, whose frames are the domain's.
    pub fn over<L: AgentLink>(&mut self, link: L) -> PrivateAgent<'_, 'm, L> {
        PrivateAgent { frames: self, link }
    }

    /// Cuts the agent's part out of a frame, and keeps it if it is accepted. A frame that is none of the domain is
    /// shown as it came, to be counted.
    fn offer(&mut self, frame: Frame<'_>, accept: &mut dyn FnMut(Frame<'_>) -> bool) -> bool {
        let Ok(view) = FrameView::new(frame.header, frame.payload, &self.whole) else {
            return accept(frame);
        };
        let next = usize::from(self.kept == Some(0));
        let Some(place) = self.places.get_mut(next) else { return false };
        let Ok(header) = view.write_private(&self.own, place.payload) else { return false };
        place.header = header;
        let is_accepted = accept(Frame { header: &header, payload: place.payload });
        if is_accepted {
            self.kept = Some(next);
        }
        is_accepted
    }
}

impl<L: AgentLink> FrameRx for PrivateAgent<'_, '_, L> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        let frames = &mut self.frames;
        self.link.receive_frames(&mut |frame| frames.offer(frame, accept))
    }

    fn frame(&self) -> Option<Frame<'_>> {
        let place = self.frames.places.get(self.frames.kept?)?;
        Some(Frame { header: &place.header, payload: place.payload })
    }
}

impl<L: AgentLink> AllocRx for PrivateAgent<'_, '_, L> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.link.receive_allocations(take)
    }
}

impl<L: AgentLink> ActionTx for PrivateAgent<'_, '_, L> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.link.send_action(action)
    }
}

impl<L: AgentLink> StatTx for PrivateAgent<'_, '_, L> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.link.send_status(status)
    }
}

impl<L: AgentLink> Bell for PrivateAgent<'_, '_, L> {
    fn token(&self) -> u32 {
        self.link.token()
    }

    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        self.link.wait_until(token, until_ns)
    }

    fn await_rings(&mut self, rings: u32) {
        self.link.await_rings(rings);
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.link.ring(role)
    }
}

impl<L: AgentLink> Clock for PrivateAgent<'_, '_, L> {
    fn now_ns(&self) -> u64 {
        self.link.now_ns()
    }
}
