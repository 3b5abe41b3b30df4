//! Encounters as bytes.

use alloc::format;
use alloc::vec::Vec;

use super::armies::{ARMIES, Army, Fate};
use super::battle::{Battle, CAPACITY, NOBODY, Order, Point, Unit};
use super::encounter::{Encounter, Outcome};
use super::units::TYPES;
use crate::bytes::{LAYOUT, Reader};
use crate::environment::StateError;

/// Bytes of an army, and of a unit.
const ARMY: usize = 5 + 8;
const UNIT: usize = 2 + 12 + 3 * 8 + 5 * 4;

/// Bytes of an encounter of so many units.
pub(super) const fn state_bytes(units: usize) -> usize {
    1 + 4 + 2 + 4 + 8 + ARMIES * ARMY + units * UNIT
}

impl Encounter {
    /// Adds its bytes.
    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        let Battle { allies, count, .. } = self.battle;
        let sizes = [allies, count - allies, self.armies.count].map(|size| size as u8);
        bytes.push(LAYOUT);
        bytes.extend(sizes);
        bytes.push(self.outcome as u8);
        bytes.extend(self.order_seed.to_le_bytes());
        bytes.extend(self.steps.to_le_bytes());
        bytes.extend(self.episode_return.to_le_bytes());
        for army in &self.armies.list {
            let Army { size, centre, attacks, to_next, since, fate } = *army;
            bytes.extend([size, attacks.into(), to_next as u8, since as u8, fate as u8]);
            write_numbers(&centre, bytes);
        }
        for (number, unit) in self.battle.units[..count].iter().enumerate() {
            bytes.extend([self.armies_of[number], self.tags[number]]);
            write_numbers(&self.before[number], bytes);
            write_unit(unit, bytes);
        }
    }

    /// Reads what [`write`](Self::write) wrote, of teams of at most these sizes.
    pub(super) fn read(bytes: &[u8], most: [usize; 2]) -> Result<Self, StateError> {
        let size = |place: usize| bytes.get(place).map_or(1, |size| usize::from(*size));
        let [allies, enemies] = [size(1), size(2)];
        let count = allies + enemies;
        let mut reader = Reader::new(bytes, state_bytes(count))?;
        if !(1..=most[0]).contains(&allies) || !(1..=most[1]).contains(&enemies) {
            return Err(StateError::Impossible(format!("{allies} allies meet {enemies} enemies")));
        }
        reader.slice(2);
        let units = [Unit::default(); CAPACITY];
        let mut encounter = Self::of(Battle { allies, count, units });
        let armies = reader.u8().into();
        reader.refuse(armies > ARMIES, || format!("there are {armies} armies"));
        encounter.armies.count = armies;
        encounter.outcome = match reader.u8() {
            0 => Outcome::Open,
            1 => Outcome::Won,
            2 => Outcome::Killed,
            3 => Outcome::Infiltrated,
            found => {
                reader.refuse(true, || format!("{found} is no outcome"));
                Outcome::Open
            }
        };
        (encounter.order_seed, encounter.steps) = (reader.u16(), reader.u32());
        encounter.episode_return = reader.f64();
        let is_number = encounter.episode_return.is_finite();
        reader.refuse(!is_number, || "its return is no number".into());
        encounter.armies.list.iter_mut().for_each(|army| *army = read_army(&mut reader));
        for number in 0..count {
            let [army, tag] = [reader.u8(), reader.u8()];
            let is_known = if number < allies || armies == 0 {
                army == NOBODY
            } else {
                usize::from(army) < armies
            };
            reader.refuse(!is_known, || format!("unit {number} is of army {army}"));
            reader.refuse(usize::from(tag) >= most[0] + most[1], || format!("a tag is {tag}"));
            (encounter.armies_of[number], encounter.tags[number]) = (army, tag);
            encounter.before[number] = read_point(&mut reader);
            encounter.battle.units[number] = read_unit(&mut reader, count);
        }
        reader.sound(encounter)
    }
}

fn write_numbers(numbers: &[f32], bytes: &mut Vec<u8>) {
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
}

fn write_unit(unit: &Unit, bytes: &mut Vec<u8>) {
    let (order, other, goal) = match unit.order {
        Order::Stop => (0, NOBODY, Point::default()),
        Order::Go(goal) => (1, NOBODY, goal),
        Order::Attack(other) => (2, other, Point::default()),
        Order::Heal(other) => (3, other, Point::default()),
        Order::Advance(goal) => (4, NOBODY, goal),
    };
    let passes = u8::from(unit.passes_left);
    bytes.extend([unit.kind, order, other, unit.target, unit.victim, unit.attacker]);
    bytes.extend([unit.wind_up, unit.flight, unit.unhurt, unit.alarm, unit.blocked, passes]);
    write_numbers(&unit.place, bytes);
    write_numbers(&goal, bytes);
    let Unit { life, shield, energy, cooldown, speed, .. } = *unit;
    write_numbers(&[life, shield, energy, cooldown, speed], bytes);
}

fn read_number(reader: &mut Reader<'_>) -> f32 {
    let number = f32::from_bits(reader.u32());
    reader.refuse(!number.is_finite(), || "one of its numbers is none".into());
    number
}

fn read_point(reader: &mut Reader<'_>) -> Point {
    [read_number(reader), read_number(reader)]
}

fn read_army(reader: &mut Reader<'_>) -> Army {
    let [size, attacks, to_next, since, fate] = core::array::from_fn(|_| reader.u8());
    let fate = match fate {
        0 => Fate::Fights,
        1 => Fate::Defeated,
        2 => Fate::Infiltrated,
        found => {
            reader.refuse(true, || format!("{found} is no fate of an army"));
            Fate::Fights
        }
    };
    let centre = read_point(reader);
    let (to_next, since) = (to_next as i8, since as i8);
    Army { size, centre, attacks: attacks != 0, to_next, since, fate }
}

fn read_unit(reader: &mut Reader<'_>, count: usize) -> Unit {
    let [kind, order, other, target, victim, attacker] = core::array::from_fn(|_| reader.u8());
    let [wind_up, flight, unhurt, alarm, blocked, passes] = core::array::from_fn(|_| reader.u8());
    reader.refuse(usize::from(kind) >= TYPES, || format!("a unit is of type {kind}"));
    for unit in [other, target, victim, attacker] {
        let is_known = unit == NOBODY || usize::from(unit) < count;
        reader.refuse(!is_known, || format!("there is no unit {unit}"));
    }
    let (place, goal) = (read_point(reader), read_point(reader));
    let order = match order {
        0 => Order::Stop,
        1 => Order::Go(goal),
        2 => Order::Attack(other),
        3 => Order::Heal(other),
        4 => Order::Advance(goal),
        found => {
            reader.refuse(true, || format!("{found} is no order"));
            Order::Stop
        }
    };
    let aims = matches!(order, Order::Attack(NOBODY) | Order::Heal(NOBODY));
    reader.refuse(aims, || "an order is aimed at nobody".into());
    let [life, shield, energy, cooldown, speed] = core::array::from_fn(|_| read_number(reader));
    Unit {
        kind,
        place,
        life,
        shield,
        energy,
        order,
        target,
        cooldown,
        wind_up,
        flight,
        victim,
        unhurt,
        attacker,
        alarm,
        speed,
        passes_left: passes != 0,
        blocked,
    }
}
