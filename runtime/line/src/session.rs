//! What two ends have agreed on, and how far they are in it.

use crate::datagram::{Head, Kind};
use crate::key::Key;

/// One end of a session.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Session {
    id: u64,
    said: u64,
    /// The number of the newest that was heard.
    heard: Option<u64>,
}

impl Session {
    /// What comes of both parts, drawn anew at every start of either end: nobody without the key knows it beforehand, and
    /// what was said in an earlier one is of no use in it.
    pub(crate) fn new(key: &Key, runner: u64, team: u64) -> Self {
        let mut parts = [0; 24];
        let of_parts = *b"session ";
        let both = of_parts.into_iter().chain(runner.to_le_bytes()).chain(team.to_le_bytes());
        parts.iter_mut().zip(both).for_each(|(to, from)| *to = from);
        let [a, b, c, d, e, f, g, h, ..] = key.tag(&parts);
        Self { id: u64::from_le_bytes([a, b, c, d, e, f, g, h]), said: 0, heard: None }
    }

    /// The head of what is said next.
    pub(crate) fn next(&mut self, kind: Kind) -> Head {
        let number = self.said;
        self.said += 1;
        Head { kind, session: self.id, number }
    }

    /// Whether it is of this session.
    pub(crate) fn is_of(&self, head: &Head) -> bool {
        head.session == self.id
    }

    /// Whether it is newer than all before, which it is from now on no more.
    pub(crate) fn takes(&mut self, head: &Head) -> bool {
        let is_newer = self.is_of(head) && self.heard.is_none_or(|heard| head.number > heard);
        if is_newer {
            self.heard = Some(head.number);
        }
        is_newer
    }
}

/// A part of a session that nobody can guess.
pub(crate) fn nonce() -> std::io::Result<u64> {
    getrandom::u64().map_err(std::io::Error::other)
}
