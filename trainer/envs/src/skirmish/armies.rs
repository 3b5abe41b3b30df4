//! Armies that come from several sides, and turn from attack to retreat and back.

use serde::{Deserialize, Serialize};

use super::battle::{Battle, NOBODY, Order, Point, Unit, UnitSet, each, length};
use super::units::{Book, MEDIVAC, UnitType};
use crate::random::{Random, below};

/// Most armies.
pub(super) const ARMIES: usize = 3;
/// An enemy that is so near to the middle is in the base.
const BASE: f32 = 2.0;

/// How an army stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Fate {
    #[default]
    Fights,
    /// None of it lives.
    Defeated,
    /// One of it reached the base.
    Infiltrated,
}

/// An army between steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Army {
    pub(super) size: u8,
    /// Where it started, and retreats to.
    pub(super) centre: Point,
    pub(super) attacks: bool,
    /// Steps until it turns, and since it has.
    pub(super) to_next: i8,
    pub(super) since: i8,
    pub(super) fate: Fate,
}

/// All armies; none where two teams meet in the open.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Armies {
    pub(super) count: usize,
    pub(super) list: [Army; ARMIES],
}

impl Armies {
    /// Draws how many there are, how large each is, of at most so many units, and when each turns first.
    pub(super) fn draw(enemies: usize, most: usize, random: &mut Random) -> Self {
        let least = enemies.div_ceil(most).max(2).min(enemies);
        let count = least + below(random, enemies.min(ARMIES) + 1 - least);
        let mut armies = Self { count, ..Self::default() };
        let mut left = enemies;
        for (after, army) in (0..count).rev().zip(&mut armies.list) {
            let fewest = left.saturating_sub(most * after).max(1);
            let size = fewest + below(random, (left - after).min(most) + 1 - fewest);
            left -= size;
            *army = Army { size: size as u8, to_next: below(random, 20) as i8, ..Army::default() };
        }
        let first = armies.list[..count].iter().map(|army| army.to_next).min().unwrap_or(0);
        armies.list[..count].iter_mut().for_each(|army| army.to_next -= first);
        armies
    }

    /// The armies that are neither defeated nor in the base, as bits.
    pub(super) fn open(&self) -> u32 {
        let fights = |number: &usize| self.list[*number].fate == Fate::Fights;
        (0..self.count).filter(fights).fold(0, |set, number| set | 1 << number)
    }

    /// Whether there can be such armies.
    pub(super) fn is_sound(&self) -> bool {
        let is_army =
            |army: &Army| army.to_next >= 0 && army.centre.into_iter().all(f32::is_finite);
        self.count <= ARMIES && self.list.iter().all(is_army)
    }

    /// Tells units of the other side what their armies do next.
    pub(super) fn command(&mut self, (battle, book): (&mut Battle, &Book), random: &mut Random) {
        for (number, army) in self.list[..self.count].iter_mut().enumerate() {
            let own = battle.army(number);
            let was_attacking = army.attacks;
            let turned = if each(own).all(|unit| !is_armed(battle.units[unit].kind)) {
                // Healers alone attack nobody.
                army.since = -20;
                (army.attacks, army.to_next) = (false, army.to_next.max(1));
                was_attacking
            } else if army.to_next == 0 {
                army.attacks = !army.attacks;
                (army.to_next, army.since) = (11 + below(random, 10) as i8, -1);
                true
            } else {
                false
            };
            let order = match army.attacks {
                true => Order::Advance([book.side / 2.0; 2]),
                false => Order::Go(army.centre),
            };
            each(if turned { own } else { 0 }).for_each(|unit| {
                battle.units[unit].order = order;
                battle.units[unit].target = NOBODY;
            });
            army.to_next -= 1;
            army.since = army.since.saturating_add(1);
        }
    }

    /// Settles what became of each army, and restores those who fought one that is defeated, where enemies were more; returns
    /// the armies whose fate is new.
    pub(super) fn settle(&mut self, (battle, book): (&mut Battle, &Book)) -> u32 {
        let mut changed = 0;
        for number in 0..self.count {
            // Whoever reached the base is in it, even if it fell there.
            let is_inside = |unit: &Unit| {
                let way = unit.place.map(|part| part - book.side / 2.0);
                usize::from(unit.army) == number && is_armed(unit.kind) && length(way) < BASE
            };
            let fate = if battle.units[battle.side(false)].iter().any(is_inside) {
                Fate::Infiltrated
            } else if battle.army(number) == 0 {
                Fate::Defeated
            } else {
                Fate::Fights
            };
            let before = core::mem::replace(&mut self.list[number].fate, fate);
            changed |= u32::from(fate != before) << number;
            if fate == Fate::Defeated && before != fate {
                self.restore((battle, book), number);
            }
        }
        changed
    }

    fn restore(&self, (battle, book): (&mut Battle, &Book), defeated: usize) {
        let (allies, enemies) = (battle.allies, battle.count - battle.allies);
        let more = enemies.saturating_sub(allies) as f32;
        let share = 4.0 * more / (allies * (self.count - 1).max(1)) as f32;
        for ally in battle.units[..allies].iter_mut().filter(|ally| ally.is_alive()) {
            if self.nearest(ally.place) == defeated {
                let UnitType { life, shield, .. } = book.types[ally.kind()];
                ally.life = (ally.life + share * life).min(life);
                ally.shield = (ally.shield + share * shield).min(shield);
            }
        }
    }

    /// The army that started nearest.
    fn nearest(&self, [x, y]: Point) -> usize {
        let way = |army: &Army| length([army.centre[0] - x, army.centre[1] - y]);
        let armies = (0..self.count).map(|number| (way(&self.list[number]), number));
        armies.min_by(|one, other| one.0.total_cmp(&other.0)).map_or(0, |(_, number)| number)
    }
}

/// Whether units of a type can win a battle.
pub(super) const fn is_armed(kind: u8) -> bool {
    kind != MEDIVAC
}

impl Battle {
    /// Those of an army that live.
    pub(super) fn army(&self, army: usize) -> UnitSet {
        let [_, living] = self.living();
        let is_own = |unit: &usize| usize::from(self.units[*unit].army) == army;
        each(living).filter(is_own).fold(0, |set, unit| set | 1 << unit)
    }
}
