//! What a supervisor tells of itself.

use sortie_core::link::{Clock, LinkError, StatTx};
use sortie_core::roles::{Counters, Identity, Presence};
use sortie_core::wire::{Role, StatMsg};

use crate::build::BUILD;
use crate::clock::MonotonicClock;

/// Its statuses so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OwnStatus(Presence);

impl OwnStatus {
    /// Says hello once, then ten times a second that it is there.
    pub(super) fn tell(
        &mut self,
        link: &mut impl StatTx,
        schema: u64,
        restarts: u64,
    ) -> Result<(), LinkError> {
        let now_ns = MonotonicClock.now_ns();
        if !self.0.is_there() {
            return self.send(link, schema, (StatMsg::HELLO, restarts), now_ns);
        }
        if !self.0.is_due(now_ns) {
            return Ok(());
        }
        self.send(link, schema, (0, restarts), now_ns)
    }

    /// Says goodbye, if it has said hello.
    pub(super) fn leave(&mut self, link: &mut impl StatTx, schema: u64) -> Result<(), LinkError> {
        if !self.0.is_there() {
            return Ok(());
        }
        self.send(link, schema, (StatMsg::BYE, 0), MonotonicClock.now_ns())
    }

    fn send(
        &mut self,
        link: &mut impl StatTx,
        schema: u64,
        (flags, restarts_seen): (u32, u64),
        now_ns: u64,
    ) -> Result<(), LinkError> {
        let identity = Identity::new(std::process::id(), "supervisor");
        let identity = Identity { build: BUILD, ..identity };
        let counters = Counters { restarts_seen, ..Counters::default() };
        let domain = (schema, Role::Supervisor);
        link.send_status(&self.0.tell(&identity, domain, &counters, flags, now_ns))
    }
}
