//! What a supervisor tells of itself.

use sortie_core::link::{Clock, LinkError, StatTx};
use sortie_core::roles::Identity;
use sortie_core::wire::{ABI, Role, StatMsg};
use zerocopy::FromZeros;

use crate::build::BUILD;
use crate::clock::MonotonicClock;

/// How often it does so.
const INTERVAL_NS: u64 = 100_000_000;
/// Index of the processes that took the place of earlier ones among a status's counters.
const RESTARTS_SEEN: usize = 12;

/// Its statuses so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OwnStatus {
    sent: u64,
    start_ns: u64,
    told_ns: u64,
}

impl OwnStatus {
    /// Says hello once, then ten times a second that it is there.
    pub(super) fn tell(
        &mut self,
        link: &mut impl StatTx,
        schema: u64,
        restarts: u64,
    ) -> Result<(), LinkError> {
        let now_ns = MonotonicClock.now_ns();
        if self.sent == 0 {
            self.start_ns = now_ns;
            return self.send(link, schema, (StatMsg::HELLO, restarts), now_ns);
        }
        if now_ns.saturating_sub(self.told_ns) < INTERVAL_NS {
            return Ok(());
        }
        self.send(link, schema, (0, restarts), now_ns)
    }

    /// Says goodbye, if it has said hello.
    pub(super) fn leave(&mut self, link: &mut impl StatTx, schema: u64) -> Result<(), LinkError> {
        if self.sent == 0 {
            return Ok(());
        }
        self.send(link, schema, (StatMsg::BYE, 0), MonotonicClock.now_ns())
    }

    fn send(
        &mut self,
        link: &mut impl StatTx,
        schema: u64,
        (flags, restarts): (u32, u64),
        now_ns: u64,
    ) -> Result<(), LinkError> {
        self.sent += 1;
        self.told_ns = now_ns;
        let Identity { pid, name, .. } = Identity::new(std::process::id(), "supervisor");
        let mut status = StatMsg {
            schema,
            seq: self.sent,
            t_ns: now_ns,
            start_ns: self.start_ns,
            pid,
            role: Role::Supervisor as u8,
            abi: ABI as u8,
            build: BUILD,
            flags,
            name,
            ..StatMsg::new_zeroed()
        };
        status.counters[RESTARTS_SEEN] = restarts;
        link.send_status(&status)
    }
}
