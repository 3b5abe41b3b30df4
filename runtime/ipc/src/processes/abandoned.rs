//! Runners and allocators whose world is gone for good.

use std::time::{Duration, Instant};

use crate::domain::Membership;
use crate::error::Error;

/// How long a role waits for the world that follows a dead one, if nobody says.
const PATIENCE: Duration = Duration::from_secs(60);
/// Pause between two looks at the world's lock of a role that gets no frames.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Whether a role has a world. One that stands still, paused or stopped, is there.
#[derive(Debug)]
pub(super) struct Abandoned {
    patience: Duration,
    /// The newest tick seen, and when the role was last known to be of use.
    tick: u64,
    looked: Instant,
    since: Option<Instant>,
}

impl Abandoned {
    pub(super) fn new(patience: Option<Duration>) -> Self {
        let patience = patience.unwrap_or(PATIENCE);
        Self { patience, tick: 0, looked: Instant::now(), since: None }
    }

    /// To be called once per heartbeat, with the newest tick.
    ///
    /// # Errors
    /// [`Error::Abandoned`] once there has been no world for too long.
    pub(super) fn check(&mut self, membership: &Membership, tick: u64) -> Result<(), Error> {
        let now = Instant::now();
        if self.tick != tick {
            *self = Self { tick, looked: now, since: None, ..*self };
            return Ok(());
        }
        if now.duration_since(self.looked) < LOOK_EVERY {
            return Ok(());
        }
        self.looked = now;
        if membership.has_world()? {
            self.since = None;
            return Ok(());
        }
        let since = *self.since.get_or_insert(now);
        if now.duration_since(since) < self.patience {
            return Ok(());
        }
        let domain = membership.domain().id().to_string();
        Err(Error::Abandoned { domain, seconds: self.patience.as_secs() })
    }
}
