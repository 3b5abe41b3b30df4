//! A battle between ticks: units, what they were told to do, and who is still there.

use core::ops::Range;

use serde::{Deserialize, Serialize};

use super::units::Book;
pub(super) use crate::battles::{CAPACITY, Point, length};

/// Units as bits.
pub(super) type UnitSet = u64;

pub(super) const NOBODY: u8 = u8::MAX;

/// What a unit was told to do; it holds until it is told something else.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) enum Order {
    #[default]
    Stop,
    /// To go there, whatever it meets.
    Go(Point),
    /// To attack a unit until it is dead, and to follow it.
    Attack(u8),
    /// To heal a unit, and to follow it.
    Heal(u8),
    /// To go there and to fight whom it meets. Units of the other side alone do so: agents have no reflexes.
    Advance(Point),
}

/// A unit between ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Unit {
    /// Its type, by its number in the [`Book`].
    pub(super) kind: u8,
    /// The army that it belongs to; nobody's of allies, and where there are no armies.
    pub(super) army: u8,
    /// A number that it has in this episode alone.
    pub(super) tag: u8,
    pub(super) place: Point,
    /// Where it was a step before.
    pub(super) before: Point,
    pub(super) life: f32,
    pub(super) shield: f32,
    pub(super) energy: f32,
    pub(super) order: Order,
    /// Whom it fights or heals.
    pub(super) target: u8,
    /// Ticks until its weapon is ready.
    pub(super) cooldown: f32,
    /// Ticks until the shot falls that it takes aim for; none without one.
    pub(super) wind_up: u8,
    /// Ticks until what it has shot hits, and whom; none where nothing is under way. Weapons are slower than missiles.
    pub(super) flight: u8,
    pub(super) victim: u8,
    /// Ticks since it was hurt, as far as they count.
    pub(super) unhurt: u8,
    /// Who hurt it or a comrade beside it, for as many ticks as are left.
    pub(super) attacker: u8,
    pub(super) alarm: u8,
    /// How far it comes in a tick, of those that gather speed.
    pub(super) speed: f32,
    /// On which side it passes what stands in its way, and for how many ticks it hardly came on.
    pub(super) passes_left: bool,
    pub(super) blocked: u8,
}

impl Unit {
    #[inline]
    pub(super) fn is_alive(&self) -> bool {
        self.life > 0.0
    }

    #[inline]
    pub(super) fn kind(&self) -> usize {
        self.kind.into()
    }
}

/// A battle between ticks. Allies, whom agents lead, come first among units.
#[derive(Clone, Debug)]
pub(super) struct Battle {
    pub(super) allies: usize,
    /// Units of both teams.
    pub(super) count: usize,
    pub(super) units: [Unit; CAPACITY],
}

impl Battle {
    /// Before it begins; places and orders are still to come.
    pub(super) fn of(book: &Book, allies: &[u8], enemies: &[u8]) -> Self {
        let mut units = [Unit::default(); CAPACITY];
        for (number, kind) in allies.iter().chain(enemies).enumerate() {
            let (kind, nature) = (*kind, &book.types[usize::from(*kind)]);
            units[number] = Unit {
                kind,
                army: NOBODY,
                life: nature.life,
                shield: nature.shield,
                energy: nature.energy,
                target: NOBODY,
                victim: NOBODY,
                attacker: NOBODY,
                unhurt: u8::MAX,
                passes_left: number % 2 == 1,
                ..Unit::default()
            };
        }
        Self { allies: allies.len(), count: allies.len() + enemies.len(), units }
    }

    /// The way from one unit to another.
    #[inline]
    pub(super) fn way(&self, from: usize, to: usize) -> Point {
        let ([x, y], [there_x, there_y]) = (self.units[from].place, self.units[to].place);
        [there_x - x, there_y - y]
    }

    /// From centre to centre.
    #[inline]
    pub(super) fn distance(&self, from: usize, to: usize) -> f32 {
        length(self.way(from, to))
    }

    /// From edge to edge, as weapons measure.
    #[inline]
    pub(super) fn gap(&self, book: &Book, from: usize, to: usize) -> f32 {
        let [radius, more] = [from, to].map(|unit| book.types[self.units[unit].kind()].radius);
        self.distance(from, to) - radius - more
    }

    /// Whether the gap is at most a range, without a root.
    #[inline]
    pub(super) fn is_within(&self, book: &Book, range: f32, from: usize, to: usize) -> bool {
        let [radius, more] = [from, to].map(|unit| book.types[self.units[unit].kind()].radius);
        let ([x, y], reach) = (self.way(from, to), range + radius + more);
        x * x + y * y <= reach * reach
    }

    /// The units of a side, alive or not.
    #[inline]
    pub(super) fn side(&self, is_ally: bool) -> Range<usize> {
        if is_ally { 0..self.allies } else { self.allies..self.count }
    }

    /// The enemy that is nearest to a unit, alive or not.
    pub(super) fn nearest_enemy(&self, unit: usize) -> usize {
        let enemies = self.side(false).map(|enemy| (self.distance(unit, enemy), enemy));
        enemies.min_by(|one, other| one.0.total_cmp(&other.0)).map_or(unit, |(_, enemy)| enemy)
    }

    /// Those of a side that live: allies, enemies.
    pub(super) fn living(&self) -> [UnitSet; 2] {
        [true, false].map(|is_ally| {
            let living = self.side(is_ally).filter(|unit| self.units[*unit].is_alive());
            living.fold(0, |set, unit| set | 1 << unit)
        })
    }
}

/// What a unit does in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Intent {
    #[default]
    Stand,
    Walk(Point),
    /// To stand, and to shoot at its target or heal it.
    Attack,
}

/// What a tick knows of all units.
pub(super) struct Scene<'a> {
    pub(super) book: &'a Book,
    /// Those that lived when units decided: allies, enemies.
    pub(super) living: [UnitSet; 2],
    pub(super) intents: [Intent; CAPACITY],
    /// Who was wounded in this tick.
    pub(super) hurt: UnitSet,
}

impl Scene<'_> {
    #[inline]
    pub(super) fn everybody(&self) -> UnitSet {
        self.living[0] | self.living[1]
    }
}

/// The members of a set, lowest first.
#[inline]
pub(super) fn each(mut set: UnitSet) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let first = (set != 0).then(|| set.trailing_zeros() as usize);
        set &= set.wrapping_sub(1);
        first
    })
}

/// How a way is scaled to a length of one, and how long it was.
#[inline]
pub(super) fn direction([x, y]: Point) -> (Point, f32) {
    let square = x * x + y * y;
    if square == 0.0 {
        return ([0.0; 2], 0.0);
    }
    let far = libm::sqrtf(square);
    ([x / far, y / far], far)
}
