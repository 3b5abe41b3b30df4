//! What a device counts, and says on its console.

use serde::Serialize;

/// The numbers of the program on the device, by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Counted {
    /// Packets with a right checksum.
    pub(crate) packets: u64,
    pub(crate) torn: u64,
    pub(crate) corrupt: u64,
    pub(crate) too_long: u64,
    /// Packets with content that the domain does not have.
    pub(crate) refused: u64,
    /// Frames that came behind a newer one which waited.
    pub(crate) overtaken: u64,
    /// Messages of another schema.
    pub(crate) foreign: u64,
    pub(crate) bad: u64,
    /// Frames and allocations that were older than the newest, or came once more.
    pub(crate) old: u64,
    /// Frames that it decided on.
    pub(crate) decided: u64,
    /// Decisions by the last allocation, when that of the frame had not come in time.
    pub(crate) stale: u64,
    /// Decisions without one.
    pub(crate) unallocated: u64,
    pub(crate) fallbacks: u64,
    /// Bytes.
    #[serde(skip)]
    pub(crate) sent: u64,
    #[serde(skip)]
    pub(crate) rest: u64,
}

impl Counted {
    /// The numbers with their names.
    pub(crate) fn named(&mut self) -> [(&'static str, &mut u64); 15] {
        [
            ("packets", &mut self.packets),
            ("torn", &mut self.torn),
            ("corrupt", &mut self.corrupt),
            ("too-long", &mut self.too_long),
            ("refused", &mut self.refused),
            ("overtaken", &mut self.overtaken),
            ("foreign", &mut self.foreign),
            ("bad", &mut self.bad),
            ("old", &mut self.old),
            ("decided", &mut self.decided),
            ("stale", &mut self.stale),
            ("unallocated", &mut self.unallocated),
            ("fallbacks", &mut self.fallbacks),
            ("sent", &mut self.sent),
            ("rest", &mut self.rest),
        ]
    }

    /// Takes a line of the console; others are somebody else's. Returns whether it is the last of them.
    pub(crate) fn read(&mut self, line: &str) -> bool {
        let Some((name, number)) = line.split_once(' ') else { return false };
        let Ok(number) = u64::from_str_radix(number, 16) else { return false };
        if let Some((_, to)) = self.named().into_iter().find(|(own, _)| *own == name) {
            *to = number;
        }
        name == "rest"
    }

    /// Pieces between zeros that it has counted: each is a packet, or was damaged.
    pub(crate) fn pieces(&self) -> u64 {
        self.packets + self.torn + self.corrupt + self.too_long
    }

    /// Adds what another incarnation counted.
    pub(crate) fn add(&mut self, mut other: Self) {
        for ((_, to), (_, from)) in self.named().into_iter().zip(other.named()) {
            *to += *from;
        }
    }
}
