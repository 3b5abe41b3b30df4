//! How the roles reach each other: traits that every transport implements, and the simplest one.
//!
//! Nobody ever waits for a reader: topics overflow, the newest message wins. Receivers drain a
//! topic each time they look, and judge every message themselves (ABI, schema, order).

mod direct;
mod private;
#[cfg(feature = "serial")]
mod serial;

pub use direct::{Direct, DirectAgent, DirectAllocator, DirectCursor, DirectWorld, FrameBlock};
pub use private::{PrivateAgent, PrivateFrames};
#[cfg(feature = "serial")]
pub use serial::{LineCounters, Relay, Serial, packet_bytes};

use crate::wire::{ActionMsg, AllocMsg, FrameError, FrameHeader, Role, StatMsg};

/// A topic or bell that failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum LinkError {
    /// Frames could not be sent or received.
    Frames,
    /// Actions could not be sent or received.
    Actions,
    /// Allocations could not be sent or received.
    Allocations,
    /// Statuses could not be sent or received.
    Statuses,
    /// A peer could not be woken.
    Bell,
    /// A frame could not be written into the memory that the link lends.
    Frame(FrameError),
}

impl core::fmt::Display for LinkError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Frames => f.write_str("frames could not be sent or received"),
            Self::Actions => f.write_str("actions could not be sent or received"),
            Self::Allocations => f.write_str("allocations could not be sent or received"),
            Self::Statuses => f.write_str("statuses could not be sent or received"),
            Self::Bell => f.write_str("a peer could not be woken"),
            Self::Frame(error) => write!(f, "a frame could not be written: {error}"),
        }
    }
}

impl core::error::Error for LinkError {}

/// A frame as received, not yet checked.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Its header.
    pub header: &'a FrameHeader,
    /// Its payload.
    pub payload: &'a [u8],
}

/// Receives frames.
pub trait FrameRx {
    /// Shows every waiting frame to `accept`, in order, and keeps the last one that it takes.
    /// Returns whether there was one.
    ///
    /// # Errors
    /// [`LinkError::Frames`].
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError>;

    /// The frame kept.
    fn frame(&self) -> Option<Frame<'_>>;
}

/// Sends frames.
pub trait FrameTx {
    /// Sends one frame, whose payload `fill` writes in place and whose header it returns.
    ///
    /// # Errors
    /// [`LinkError::Frames`], or what `fill` reports.
    fn send_frame(
        &mut self,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>,
    ) -> Result<(), LinkError>;
}

/// Receives actions.
pub trait ActionRx {
    /// Shows every waiting action to `take`.
    ///
    /// # Errors
    /// [`LinkError::Actions`].
    fn receive_actions(&mut self, take: &mut dyn FnMut(&ActionMsg)) -> Result<(), LinkError>;
}

/// Sends actions.
pub trait ActionTx {
    /// Sends one action.
    ///
    /// # Errors
    /// [`LinkError::Actions`].
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError>;
}

/// Receives allocations. A late joiner is shown the newest one.
pub trait AllocRx {
    /// Shows every waiting allocation to `take`.
    ///
    /// # Errors
    /// [`LinkError::Allocations`].
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError>;
}

/// Sends allocations.
pub trait AllocTx {
    /// Sends one allocation.
    ///
    /// # Errors
    /// [`LinkError::Allocations`].
    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError>;
}

/// Receives statuses. A late joiner is shown the newest one of each process.
pub trait StatRx {
    /// Shows every waiting status to `take`.
    ///
    /// # Errors
    /// [`LinkError::Statuses`].
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError>;
}

/// Sends statuses.
pub trait StatTx {
    /// Sends one status.
    ///
    /// # Errors
    /// [`LinkError::Statuses`].
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError>;
}

/// How a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wake {
    /// Somebody rang, or a signal came.
    Rung,
    /// The time passed.
    Timeout,
}

/// Wakes peers and waits for being woken.
pub trait Bell {
    /// The bell's state. Taken before looking at the topics, so that no ring is lost in between.
    fn token(&self) -> u32;

    /// Waits until somebody rang since `token` was taken, or until `until_ns`.
    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake;

    /// Lets the next wait sleep through all but the last of so many rings. A wait may end earlier:
    /// bells that cannot tell rings apart end it with the first.
    fn await_rings(&mut self, _rings: u32) {}

    /// Wakes every process of `role`.
    ///
    /// # Errors
    /// [`LinkError::Bell`].
    fn ring(&mut self, role: Role) -> Result<(), LinkError>;
}

/// The domain's clock: monotonic, in nanoseconds, the same for all its processes.
pub trait Clock {
    /// Now.
    fn now_ns(&self) -> u64;
}

/// The processor of a board: its clock, and how it waits.
pub trait Processor: Clock + Sync {
    /// Waits for an event, on Cortex-M by `wfe`; may return at any time.
    fn rest(&self) {
        core::hint::spin_loop();
    }
}

/// All that a runner needs.
pub trait AgentLink: FrameRx + AllocRx + ActionTx + StatTx + Bell + Clock {}
impl<L: FrameRx + AllocRx + ActionTx + StatTx + Bell + Clock> AgentLink for L {}

/// All that the world needs.
pub trait WorldLink: FrameTx + ActionRx + AllocRx + StatRx + StatTx + Bell + Clock {}
impl<L: FrameTx + ActionRx + AllocRx + StatRx + StatTx + Bell + Clock> WorldLink for L {}

/// All that the allocator needs.
pub trait AllocLink: FrameRx + AllocTx + StatTx + Bell + Clock {}
impl<L: FrameRx + AllocTx + StatTx + Bell + Clock> AllocLink for L {}
