//! What a server tells of itself, and what it does when it is told to.

use sortie_core::roles::{Counters, Identity, Presence};
use sortie_core::wire::{Command, ControlStatus, Role, StatMsg};

use super::engine::Engine;
use super::served::{ServeCounters, Served};
use crate::build::BUILD;
use crate::process_info::ProcessInfo;
use crate::processes::Controlled;

/// A server as others see it.
pub(super) struct ServerPresence {
    presence: Presence,
    identity: Identity,
    schema: u64,
    /// Number of the newest observation, in its session.
    newest: u64,
    /// Of requests: what is counted of observations stands elsewhere.
    counters: Counters,
    is_over: bool,
}

impl ServerPresence {
    pub(super) fn new(engine: &dyn Engine, schema: u64) -> Self {
        let identity = Identity {
            model: engine.model(),
            is_graph: engine.is_graph(),
            build: BUILD,
            ..Identity::new(std::process::id(), "policy")
        };
        Self {
            presence: Presence::default(),
            identity,
            schema,
            newest: 0,
            counters: Counters::default(),
            is_over: false,
        }
    }

    pub(super) fn note(&mut self, served: &Served) {
        self.newest = served.seq;
        self.presence.note(served.wake_ns, served.decide_ns);
    }

    /// Whether it was told to end.
    pub(super) fn is_over(&self) -> bool {
        self.is_over
    }

    /// The next status, with `flags`.
    pub(super) fn tell(&mut self, met: &ServeCounters, flags: u32, now_ns: u64) -> StatMsg {
        let counters = Counters {
            ticks: met.answered + met.fallbacks,
            frame_gaps: met.missed,
            late: met.late,
            fallbacks: met.fallbacks,
            schema_rejects: met.refused + self.counters.schema_rejects,
            // The first one took nobody's place.
            restarts_seen: met.sessions.saturating_sub(1),
            ..self.counters
        };
        let domain = (self.schema, Role::Runner);
        let told = self.presence.tell(&self.identity, domain, &counters, flags, now_ns);
        StatMsg { last_tick: self.newest, ..told }
    }
}

impl Controlled for ServerPresence {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.newest
    }

    fn info(&self) -> ProcessInfo {
        ProcessInfo { serves: true, ..ProcessInfo::new(Role::Runner, &self.identity) }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        &mut self.counters
    }

    fn obey(&mut self, command: Command, _: &str) -> ControlStatus {
        match command {
            Command::ShutDown => {
                self.is_over = true;
                ControlStatus::Done
            }
            // Another policy takes or gives something else: its server is started instead.
            Command::ReloadModel => ControlStatus::NotSupported,
            _ => ControlStatus::NotMine,
        }
    }
}
