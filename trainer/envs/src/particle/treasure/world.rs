//! What an episode has: agents, what collectors hold, treasures; and what one step does to them.
//!
//! Rewards and observations of a step tell of holdings and treasures as they stood before anything was taken or
//! brought in that step. So both are kept: as they stand, and as they are seen.

use alloc::vec::Vec;

use super::{BANK, COLLECTOR, TREASURE_RADIUS, TreasureCollection};
use crate::bytes::Reader;
use crate::particle::physics::{
    Mover, Nearest, Point, advance, from_to, plus, squared, squared_distance, times, touch,
};
use crate::particle::scenario::{write_choice, write_movers, write_point};

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
        let held = |bytes: &mut Reader<'_>| bytes.choice("a collector holds kind", kinds);
        Self {
            movers: (0..agents).map(|_| bytes.mover()).collect(),
            hands: (0..collectors).map(|_| Hand { now: held(bytes), seen: held(bytes) }).collect(),
            treasures: (0..collectors).map(|_| Treasure::read(kinds, bytes)).collect(),
            taken: bytes.u32(),
            delivered: bytes.u32(),
            collisions: bytes.u32(),
        }
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

/// What all earn by each pair of a holder at its bank, and of a free collector at a treasure.
const FOUND: f64 = 5.0;
/// What a collector loses by each other that it touches.
const BUMP: f64 = 5.0;
/// What an agent loses by its distance from where it should be.
const WAY: f64 = 0.1;

const TAKES: f64 = COLLECTOR.radius + TREASURE_RADIUS;
const BRINGS: f64 = COLLECTOR.radius + BANK.radius;
const BUMPS: f64 = 2.0 * COLLECTOR.radius;

impl TreasureCollection {
    /// Plays a step in which `draw` says place and kind of each treasure, by its number, that follows a taken one.
    pub(in crate::particle) fn step_by(
        &self,
        world: &mut Hoard,
        actions: &[u16],
        rewards: &mut [f64],
        draw: impl FnMut(usize) -> (Point, u8),
    ) {
        advance(&mut world.movers, &self.bodies, actions);
        self.reward(world, rewards);
        self.take(world, draw);
        self.bring(world);
    }

    /// Writes what each agent earns: pairs that touch count, not what becomes of them.
    fn reward(&self, world: &mut Hoard, rewards: &mut [f64]) {
        let mut found = 0;
        rewards.fill(0.0);
        for (collector, hand) in world.hands.iter().enumerate() {
            let own = world.movers[collector].position;
            let (reached, squared) = match hand.now {
                None => at_treasures(world, own),
                Some(kind) => {
                    let bank = world.movers[self.bank_of(kind)].position;
                    let squared = squared_distance(own, bank);
                    (u32::from(touch(BRINGS, squared)), squared)
                }
            };
            found += reached;
            rewards[collector] -= WAY * libm::sqrt(squared);
            for (other, mover) in world.movers[..collector].iter().enumerate() {
                if touch(BUMPS, squared_distance(own, mover.position)) {
                    rewards[collector] -= BUMP;
                    rewards[other] -= BUMP;
                    world.collisions += 1;
                }
            }
        }
        for (bank, kind) in (self.collectors..).zip(0..self.banks() as u8) {
            rewards[bank] -= WAY * libm::sqrt(self.way_to_holders(world, bank, kind));
        }
        rewards.iter_mut().for_each(|reward| *reward += FOUND * f64::from(found));
    }

    /// The squared distance of a bank to the nearest holder of its kind; without one, of the mean way to the nearest
    /// collectors.
    fn way_to_holders(&self, world: &Hoard, bank: usize, kind: u8) -> f64 {
        let own = world.movers[bank].position;
        let collectors = || world.movers[..self.collectors].iter().map(|mover| mover.position);
        let holders =
            world.hands.iter().zip(collectors()).filter(|(hand, _)| hand.now == Some(kind));
        let nearest = holders.map(|(_, place)| squared_distance(own, place)).reduce(f64::min);
        nearest.unwrap_or_else(|| {
            let near = Nearest::to(own, collectors().enumerate());
            let share = 1.0 / near.things().len() as f64;
            let ways = near.things().map(|other| from_to(own, world.movers[other].position));
            squared(times(share, ways.fold([0.0; 2], plus)))
        })
    }

    /// Free collectors take treasures that they touch; where one was taken a step before, another one follows.
    fn take(&self, world: &mut Hoard, mut draw: impl FnMut(usize) -> (Point, u8)) {
        let Hoard { movers, hands, treasures, taken, .. } = world;
        hands.iter_mut().for_each(|hand| hand.seen = hand.now);
        for (number, treasure) in treasures.iter_mut().enumerate() {
            if treasure.stage == Stage::Taken {
                treasure.stage = Stage::New(treasure.kind);
                (treasure.position, treasure.kind) = draw(number);
                continue;
            }
            treasure.stage = Stage::Lies;
            let touches =
                |mover: &Mover| touch(TAKES, squared_distance(mover.position, treasure.position));
            let mut free = hands.iter_mut().zip(&*movers).filter(|(hand, _)| hand.now.is_none());
            if let Some((hand, _)) = free.find(|(_, mover)| touches(mover)) {
                hand.now = Some(treasure.kind);
                treasure.stage = Stage::Taken;
                *taken += 1;
            }
        }
    }

    /// Holders that touch their bank give away what they hold, also what they have just taken.
    fn bring(&self, world: &mut Hoard) {
        for (hand, mover) in world.hands.iter_mut().zip(&world.movers) {
            let Some(kind) = hand.now else { continue };
            let bank = world.movers[self.bank_of(kind)].position;
            if touch(BRINGS, squared_distance(mover.position, bank)) {
                hand.now = None;
                world.delivered += 1;
            }
        }
    }
}

/// Treasures that a collector touches, and its squared distance to the nearest, dead ones far away among them.
fn at_treasures(world: &Hoard, own: Point) -> (u32, f64) {
    let squared = world.treasures.iter().map(|treasure| squared_distance(own, treasure.place()));
    squared.fold((0, f64::INFINITY), |(touched, nearest), squared| {
        (touched + u32::from(touch(TAKES, squared)), nearest.min(squared))
    })
}
