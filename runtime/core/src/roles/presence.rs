//! Joining and leaving.

use zerocopy::FromZeros;

use super::Counters;
use super::durations::Durations;
use crate::wire::{ABI, Role, StatMsg};

/// A process that is there says so this often.
const STATUS_INTERVAL_NS: u64 = 100_000_000;

/// Who a process is: what it puts into its messages.
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// Process id.
    pub pid: u32,
    /// First 16 bytes of the model's id.
    pub model: [u8; 16],
    /// Whether an engine runs its network's graph, see [`StatMsg::GRAPH`].
    pub is_graph: bool,
    /// Build of the program.
    pub build: u32,
    /// Port name, zero padded.
    pub name: [u8; 48],
}

impl Identity {
    /// The identity of process `pid` under a port name, of which 48 bytes are kept.
    pub fn new(pid: u32, name: &str) -> Self {
        let mut padded = [0; 48];
        for (to, from) in padded.iter_mut().zip(name.bytes()) {
            *to = from;
        }
        Self { pid, model: [0; 16], is_graph: false, build: 0, name: padded }
    }

    /// First 4 bytes of the model's id.
    pub(super) fn short_model(&self) -> u32 {
        let [a, b, c, d, ..] = self.model;
        u32::from_le_bytes([a, b, c, d])
    }
}

/// What a process tells of itself, and when: a world that starts later learns from it who is there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Presence {
    sent: u64,
    start_ns: u64,
    told_ns: u64,
    is_there: bool,
    /// From a message that woke the process to its running.
    pub(super) wakes: Durations,
    /// From its running to its own message.
    pub(super) works: Durations,
}

impl Presence {
    /// Counts what was answered: the time from the message that woke the process to its running, and from there to its
    /// own message.
    pub fn note(&mut self, wake_ns: u64, work_ns: u64) {
        self.wakes.note(wake_ns);
        self.works.note(work_ns);
    }

    /// Whether the process has said hello, and not goodbye.
    pub fn is_there(&self) -> bool {
        self.is_there
    }

    /// Whether a process that has said hello is to be heard of again.
    pub fn is_due(&self, now_ns: u64) -> bool {
        self.is_there && now_ns.saturating_sub(self.told_ns) >= STATUS_INTERVAL_NS
    }

    /// The next status of a process, with `flags`: [`StatMsg::HELLO`] first, [`StatMsg::BYE`] at last.
    pub fn tell(
        &mut self,
        identity: &Identity,
        (schema, role): (u64, Role),
        counters: &Counters,
        flags: u32,
        now_ns: u64,
    ) -> StatMsg {
        if self.sent == 0 {
            self.start_ns = now_ns;
        }
        self.sent += 1;
        self.told_ns = now_ns;
        self.is_there = flags & StatMsg::BYE == 0;
        let flags = if identity.is_graph { flags | StatMsg::GRAPH } else { flags };
        StatMsg {
            schema,
            seq: self.sent,
            t_ns: now_ns,
            start_ns: self.start_ns,
            pid: identity.pid,
            role: role as u8,
            abi: ABI as u8,
            model: identity.model,
            build: identity.build,
            flags,
            counters: counters.to_wire(),
            hist_wake: self.wakes.to_wire(),
            hist_work: self.works.to_wire(),
            name: identity.name,
            ..StatMsg::new_zeroed()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_heard_of_ten_times_a_second_between_hello_and_goodbye() {
        let mut presence = Presence::default();
        let identity = Identity::new(7, "runner/0");
        assert!(!presence.is_due(u64::MAX));
        let tell = |presence: &mut Presence, flags, now| {
            presence.tell(&identity, (5, Role::Runner), &Counters::default(), flags, now)
        };
        let hello = tell(&mut presence, StatMsg::HELLO, 40);
        assert_eq!((hello.seq, hello.start_ns, hello.pid, hello.schema), (1, 40, 7, 5));
        assert!(!presence.is_due(40 + STATUS_INTERVAL_NS - 1));
        assert!(presence.is_due(40 + STATUS_INTERVAL_NS));
        tell(&mut presence, StatMsg::BYE, 90);
        assert!(!presence.is_due(u64::MAX));
        let graph = Identity { is_graph: true, ..identity };
        let told = |identity: &Identity| {
            let domain = (5, Role::Runner);
            Presence::default().tell(identity, domain, &Counters::default(), StatMsg::HELLO, 40)
        };
        assert!(told(&graph).has(StatMsg::HELLO | StatMsg::GRAPH));
        assert!(!told(&identity).has(StatMsg::GRAPH));
    }
}
