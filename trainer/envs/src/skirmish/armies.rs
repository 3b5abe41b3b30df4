//! Armies that come from several sides, and turn from attack to retreat and back.

use super::battle::{Battle, NOBODY, Order, Point, UnitSet, length};
use super::units::{Book, MEDIVAC, UnitType};
use crate::observation::members;
use crate::random::{Random, below};

/// Most armies.
pub(super) const ARMIES: usize = 3;
/// An enemy that is so near to the middle is in the base.
pub(super) const BASE: f32 = 2.0;

/// How an army stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Fate {
    #[default]
    Fights,
    /// None of it lives.
    Defeated,
    /// One of it reached the base.
    Infiltrated,
}

/// An army between steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
#[derive(Clone, Debug, Default, PartialEq)]
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

    /// Tells units of the other side what their armies do next.
    pub(super) fn command(
        &mut self,
        (battle, book): (&mut Battle, &Book),
        armies_of: &[u8],
        random: &mut Random,
    ) {
        let [_, living] = battle.living();
        for (number, army) in self.list[..self.count].iter_mut().enumerate() {
            let own = of_army(living, armies_of, number);
            let was_attacking = army.attacks;
            let turned = if members(own.into()).all(|unit| !is_armed(battle.units[unit].kind)) {
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
            members(if turned { own.into() } else { 0 }).for_each(|unit| {
                battle.units[unit].order = order;
                battle.units[unit].target = NOBODY;
            });
            army.to_next -= 1;
            army.since = army.since.saturating_add(1);
        }
    }

    /// Settles what became of each army, and restores those who fought one that is defeated, where enemies were more; returns
    /// the armies whose fate is new.
    pub(super) fn settle(&mut self, (battle, book): (&mut Battle, &Book), armies_of: &[u8]) -> u32 {
        let [_, living] = battle.living();
        let mut changed = 0;
        for number in 0..self.count {
            let all = of_army(UnitSet::MAX, armies_of, number);
            let is_inside = |unit: usize| {
                let [x, y] = battle.units[unit].place.map(|part| part - book.side / 2.0);
                is_armed(battle.units[unit].kind) && length([x, y]) < BASE
            };
            let fate = if members(all.into()).any(is_inside) {
                Fate::Infiltrated
            } else if all & living == 0 {
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

/// Those units of a set that belong to an army.
pub(super) fn of_army(set: UnitSet, armies_of: &[u8], army: usize) -> UnitSet {
    let own = armies_of.iter().enumerate().filter(|(_, own)| usize::from(**own) == army);
    set & own.fold(0, |set, (unit, _)| set | 1 << unit)
}
