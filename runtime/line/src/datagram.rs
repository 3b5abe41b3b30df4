//! What goes over a line: a head, what is said, and a checksum of both; and which of it an end takes.

use std::collections::VecDeque;
use std::io::Read;

use serde::{Deserialize, Serialize};
use sortie_core::Shape;

use crate::key::{Key, TAG};

/// What every datagram begins with: the line's own version is part of it.
const MAGIC: [u8; 4] = *b"SLN1";
/// Bytes of a head.
const HEAD: usize = 24;
/// Most bytes of what UDP takes.
pub(crate) const LONGEST: usize = 65_507;
/// Most bytes of what is said in one.
pub(crate) const LONGEST_SAID: usize = LONGEST - HEAD - TAG;

/// Who says what. Each kind goes one way only: what an end has said itself is nothing to it when it comes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A runner asks to be taken.
    Offer = 1,
    /// The team would take it.
    Welcome = 2,
    /// The team does not take it.
    Refusal = 3,
    /// From the team to the runner.
    Shown = 4,
    /// From the runner to the team.
    Answered = 5,
}

impl Kind {
    fn from_number(number: u8) -> Option<Self> {
        [Self::Offer, Self::Welcome, Self::Refusal, Self::Shown, Self::Answered]
            .into_iter()
            .find(|kind| *kind as u8 == number)
    }
}

/// What a datagram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Head {
    pub(crate) kind: Kind,
    /// What both ends have agreed on; before they have: the runner's part of it.
    pub(crate) session: u64,
    /// How many its sender has said before in this session.
    pub(crate) number: u64,
}

/// A datagram of a head and what is said.
pub(crate) fn seal(key: &Key, head: Head, said: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD + said.len() + TAG);
    bytes.extend(MAGIC);
    bytes.extend([head.kind as u8, 0, 0, 0]);
    bytes.extend(head.session.to_le_bytes());
    bytes.extend(head.number.to_le_bytes());
    bytes.extend(said);
    let tag = key.tag(&bytes);
    bytes.extend(tag);
    bytes
}

/// What a datagram says; `None`: it was damaged, or is of somebody who does not have the key.
pub(crate) fn open<'a>(key: &Key, datagram: &'a [u8]) -> Option<(Head, &'a [u8])> {
    let (bytes, tag) = datagram.split_last_chunk::<TAG>()?;
    let (head, said) = bytes.split_first_chunk::<HEAD>()?;
    let (magic, rest) = head.split_first_chunk::<4>()?;
    if *magic != MAGIC || !key.fits(bytes, tag) {
        return None;
    }
    let ([kind, ..], rest) = rest.split_first_chunk::<4>()?;
    let (session, number) = rest.split_first_chunk::<8>()?;
    let head = Head {
        kind: Kind::from_number(*kind)?,
        session: u64::from_le_bytes(*session),
        number: u64::from_le_bytes(number.try_into().ok()?),
    };
    Some((head, said))
}

/// What a runner has to offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Offer {
    /// Version of the messages.
    pub abi: u16,
    /// Hash of the contract that its policy acts under.
    pub contract: u64,
    /// First 16 bytes of its bundle's id.
    pub model: [u8; 16],
    /// The agents that it would act for: bit a for agent a.
    pub agents: u64,
}

/// What a runner has to know of its team.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Team {
    /// Padded sizes: agents, entities, subtasks, actions, features.
    sizes: [u32; 5],
    /// Nanoseconds from frame to frame; 0: as long as the team takes.
    pub period_ns: u64,
    /// The runner's host, by which its process ids are told from those of others.
    pub host: u16,
}

impl Team {
    /// A team of this shape and period.
    pub fn new(shape: Shape, period_ns: u64, host: u16) -> Self {
        let Shape { agents, entities, tasks, actions, features } = shape;
        // The limits of frames fit 32 bits.
        let sizes = [agents, entities, tasks, actions, features].map(|size| size as u32);
        Self { sizes, period_ns, host }
    }

    /// The padded sizes.
    pub fn shape(&self) -> Shape {
        let [agents, entities, tasks, actions, features] = self.sizes.map(|size| size as usize);
        Shape { agents, entities, tasks, actions, features }
    }
}

/// The team's part of a session, with what its runner has to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Welcome {
    pub(crate) nonce: u64,
    pub(crate) team: Team,
}

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

/// Takes as much of what waits as there is room for, and returns how much.
pub(crate) fn take(waiting: &mut VecDeque<u8>, room: &mut [u8]) -> usize {
    // Memory does not fail.
    waiting.read(room).unwrap_or(0)
}
