//! What an episode has: agents, what collectors hold, treasures.
//!
//! Rewards and observations of a step tell of holdings and treasures as they stood before anything was taken or
//! brought in that step. So both are kept: as they stand, and as they are seen.

use alloc::vec::Vec;

use crate::particle::bytes::{Reader, write_choice, write_movers, write_point};
use crate::particle::physics::Mover;
use crate::particle::plane::Point;

/// Where a treasure is that was taken.
const FAR: Point = [-999.0; 2];

/// Where everything is, and who holds what.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hoard {
    /// The collectors, then the banks.
    pub movers: Vec<Mover>,
    /// What each collector holds.
    pub hands: Vec<Hand>,
    /// The treasures.
    pub treasures: Vec<Treasure>,
    /// Treasures that were taken so far.
    pub taken: u32,
    /// Treasures that were brought to their bank so far.
    pub delivered: u32,
    /// Steps of touching pairs of collectors so far.
    pub collisions: u32,
}

/// What a collector holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hand {
    /// Kind of the treasure that it holds.
    pub now: Option<u8>,
    /// As agents see it: before the last step's taking and bringing.
    pub seen: Option<u8>,
}

/// One treasure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Treasure {
    /// Where it lies, or lay until it was taken.
    pub position: Point,
    /// Its kind.
    pub kind: u8,
    /// What the last step did with it.
    pub stage: Stage,
}

/// What the last step did with a treasure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// Nothing, it lies there.
    #[default]
    Lies,
    /// It was taken: dead for one step, while agents still see it.
    Taken,
    /// It is another one, while agents still see the old one of this kind dead.
    New(u8),
}

impl Treasure {
    /// Whether it can be taken.
    pub fn is_alive(&self) -> bool {
        self.stage != Stage::Taken
    }

    /// Where it counts as being.
    #[inline]
    pub fn place(&self) -> Point {
        if self.is_alive() { self.position } else { FAR }
    }

    /// Whether agents see it dead.
    #[inline]
    pub fn is_seen_dead(&self) -> bool {
        matches!(self.stage, Stage::New(_))
    }

    /// Where agents see it.
    #[inline]
    pub fn seen_place(&self) -> Point {
        if self.is_seen_dead() { FAR } else { self.position }
    }

    /// As which kind agents see it.
    #[inline]
    pub fn seen_kind(&self) -> u8 {
        if let Stage::New(old) = self.stage { old } else { self.kind }
    }
}

impl Hoard {
    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        write_movers(&self.movers, bytes);
        for hand in &self.hands {
            write_choice(hand.now, bytes);
            write_choice(hand.seen, bytes);
        }
        for treasure in &self.treasures {
            write_point(treasure.position, bytes);
            let (stage, seen) = match treasure.stage {
                Stage::Lies => (0, 0),
                Stage::Taken => (1, 0),
                Stage::New(seen) => (2, seen),
            };
            bytes.extend_from_slice(&[treasure.kind, stage, seen]);
        }
        for count in [self.taken, self.delivered, self.collisions] {
            bytes.extend_from_slice(&count.to_le_bytes());
        }
    }

    pub(super) fn read(agents: usize, collectors: usize, bytes: &mut Reader<'_>) -> Self {
        let kinds = agents - collectors;
        Self {
            movers: (0..agents).map(|_| bytes.mover()).collect(),
            hands: (0..collectors).map(|_| Hand::read(kinds, bytes)).collect(),
            treasures: (0..collectors).map(|_| Treasure::read(kinds, bytes)).collect(),
            taken: bytes.count(),
            delivered: bytes.count(),
            collisions: bytes.count(),
        }
    }
}

impl Hand {
    fn read(kinds: usize, bytes: &mut Reader<'_>) -> Self {
        let mut hold = || bytes.choice("a collector holds kind", kinds);
        Self { now: hold(), seen: hold() }
    }
}

impl Treasure {
    fn read(kinds: usize, bytes: &mut Reader<'_>) -> Self {
        let position = bytes.point();
        let kind = bytes.index("a treasure is of kind", kinds);
        let stage = bytes.index("a treasure is in stage", 3);
        let seen = bytes.index("a treasure was of kind", kinds);
        let stage = match stage {
            0 => Stage::Lies,
            1 => Stage::Taken,
            _ => Stage::New(seen),
        };
        Self { position, kind, stage }
    }
}
