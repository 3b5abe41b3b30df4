//! How the processes of a domain wake each other.

use serde::{Deserialize, Serialize};

/// What a domain's bells are. All its processes use the same: who listens to the one is not woken by
/// the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BellKind {
    /// Counters in shared memory on which the kernel lets processes sleep. Linux only.
    Doorbell,
    /// Events of iceoryx2: a socket for each listener.
    Event,
}

impl Default for BellKind {
    /// The doorbell where the system has it.
    fn default() -> Self {
        if cfg!(target_os = "linux") { Self::Doorbell } else { Self::Event }
    }
}
