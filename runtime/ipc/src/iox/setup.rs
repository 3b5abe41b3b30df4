//! What every link is opened with.

use std::time::Duration;

use sortie_core::wire::FrameFormat;

use crate::domain::{BellKind, Domain};

/// What a link is opened with.
#[derive(Clone, Copy, Debug)]
pub struct LinkSetup<'a> {
    /// The domain, which this process has entered.
    pub domain: &'a Domain,
    /// Its frames.
    pub format: FrameFormat,
    /// Name of the process's node and ports.
    pub name: &'a str,
    /// How its processes wake each other.
    pub bell: BellKind,
    /// How long waits linger before they sleep; with doorbells only.
    pub linger: Duration,
}
