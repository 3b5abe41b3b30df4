//! A record as it grows: messages as they are, and a line a tick for people.

use sortie_core::wire::{ABI, ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};
use sortie_ipc::{DomainFacts, Heard, model_text};
use sortie_record::{Message, Writer};
use zerocopy::IntoBytes;

use super::ticks::{self, Ticks};
use crate::failure::Failure;
use crate::listener::Missed;

/// The channels, by their numbers; their schemas have the same ones.
const FRAME: u16 = 1;
const ACTION: u16 = 2;
const ALLOCATION: u16 = 3;
const STATUS: u16 = 4;
pub(super) const TICK: u16 = 5;
/// Topics of messages as they are, what they are called on the wire, and their bytes.
const MESSAGES: [(u16, &str, &str, usize); 4] = [
    (FRAME, "/frame", "sortie.Frame", size_of::<FrameHeader>()),
    (ACTION, "/action", "sortie.ActionMsg", size_of::<ActionMsg>()),
    (ALLOCATION, "/allocation", "sortie.AllocMsg", size_of::<AllocMsg>()),
    (STATUS, "/status", "sortie.StatMsg", size_of::<StatMsg>()),
];
/// The encoding of messages as they are.
const OWN: &str = "sortie";

/// A record that is being written, wherever it goes.
pub(super) struct Log {
    pub(super) writer: Writer,
    /// What is added to a time of the domain's clock to have one since 1970.
    ahead_ns: u64,
    /// When the last message was read.
    now_ns: u64,
    ticks: Ticks,
    missed: Missed,
    /// What was missed before the file began.
    missed_before: u64,
}

impl Log {
    /// Begins a record of a domain.
    pub(super) fn new(facts: &DomainFacts, ahead_ns: u64) -> Result<Self, Failure> {
        let mut writer = Writer::new(OWN, concat!("sortie ", env!("CARGO_PKG_VERSION")));
        let text = toml::to_string(facts).map_err(Failure::bug)?;
        for (id, topic, name, bytes) in MESSAGES {
            // Who reads it needs the version of the layout, and the sizes of what follows a frame's head.
            let layout = format!("abi = {ABI}\nbytes = {bytes}\n\n[domain]\n{text}");
            writer.add_schema(id, [name, OWN], layout.as_bytes());
            writer.add_channel(id, id, [topic, OWN]);
        }
        writer.add_schema(TICK, ["sortie.Tick", "jsonschema"], ticks::SCHEMA.as_bytes());
        writer.add_channel(TICK, TICK, ["/tick", "json"]);
        writer.add_attachment(["domain.toml", "application/toml"], ahead_ns, text.as_bytes());
        let agents = facts.shape().agents;
        let (ticks, missed) = (Ticks::new(agents), Missed::default());
        Ok(Self { writer, ahead_ns, now_ns: 0, ticks, missed, missed_before: 0 })
    }

    /// A file that the record brings along.
    pub(super) fn attach(&mut self, name: &str, data: &[u8]) {
        let media_type = "application/octet-stream";
        self.writer.add_attachment([name, media_type], self.ahead_ns, data);
    }

    /// Adds a message that was read at this time of the domain's clock. Returns whether the team ends with it.
    pub(super) fn add(&mut self, heard: Heard<'_>, now_ns: u64) -> bool {
        self.now_ns = now_ns;
        let is_first = self.missed.note(heard);
        match heard {
            Heard::Frame(header, payload) => {
                self.end_tick();
                self.ticks.begin(header);
                let parts: [&[u8]; 2] = [header.as_bytes(), payload];
                self.message(FRAME, header.seq, header.t_ns, &parts);
                return header.has(FrameHeader::SHUTDOWN);
            }
            Heard::Allocation(it) => {
                self.ticks.allocate(it);
                self.message(ALLOCATION, it.seq, it.t_ns, &[it.as_bytes()]);
            }
            Heard::Action(it) => {
                self.ticks.act(it);
                self.message(ACTION, it.seq, it.t_ns, &[it.as_bytes()]);
            }
            Heard::Status(it) => {
                if is_first {
                    self.introduce(it);
                }
                self.message(STATUS, it.seq, it.t_ns, &[it.as_bytes()]);
            }
        }
        false
    }

    fn message(&mut self, channel: u16, number: u64, sent_ns: u64, parts: &[&[u8]]) {
        let message = Message {
            channel,
            sequence: number as u32,
            log_time: self.now_ns.saturating_add(self.ahead_ns),
            publish_time: sent_ns.saturating_add(self.ahead_ns),
        };
        self.writer.add_message(message, parts);
    }

    /// Says of a process what its messages do not.
    fn introduce(&mut self, status: &StatMsg) {
        let role = Role::from_number(status.role).map_or("unknown", Role::name);
        let name = status.name.split(|byte| *byte == 0).next().unwrap_or_default();
        let entries = [
            ("role", role.to_owned()),
            ("name", String::from_utf8_lossy(name).into_owned()),
            ("agents", format!("{:#x}", status.agents)),
            ("model", model_text(status.model)),
            ("build", format!("{:08x}", status.build)),
            ("start_ns", status.start_ns.saturating_add(self.ahead_ns).to_string()),
        ];
        self.writer.add_metadata(&format!("process/{}", status.pid), &entries);
    }

    fn end_tick(&mut self) {
        let Some((tick, sent_ns, line)) = self.ticks.end() else { return };
        let message = Message {
            channel: TICK,
            sequence: tick as u32,
            log_time: self.now_ns.saturating_add(self.ahead_ns),
            publish_time: sent_ns.saturating_add(self.ahead_ns),
        };
        self.writer.add_message(message, &[line.as_bytes()]);
    }

    /// Ticks of which a frame was recorded.
    pub(super) fn ticks(&self) -> u64 {
        self.ticks.count()
    }

    /// Ends what belongs to a file. Returns how many messages were missed since the one before.
    pub(super) fn end_file(&mut self) -> u64 {
        self.end_tick();
        let before = std::mem::replace(&mut self.missed_before, self.missed.count());
        self.missed.count() - before
    }
}
