//! What an encounter looks like.

use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::battle::{NOBODY, Order};
use super::encounter::Encounter;
use super::observation::shares;
use super::units::{Book, TYPE_NAMES, TYPES};
use crate::picture::{Bar, Disc, Field, Link, Outline, Picture, lettered};

/// How units of each type are drawn.
const OUTLINES: [Outline; TYPES] = [
    Outline::Triangle,
    Outline::Square,
    Outline::Circle,
    Outline::Cross,
    Outline::Diamond,
    Outline::Circle,
];

/// All that live where they are, with lines to whom they fight or heal.
pub(super) fn picture(encounter: &Encounter, book: &Book) -> Picture {
    let battle = &encounter.battle;
    let living = battle.units[..battle.count].iter().enumerate();
    let disc = |number: usize| {
        let unit = &battle.units[number];
        let nature = &book.types[unit.kind()];
        let army = unit.army;
        let is_ally = number < battle.allies;
        let [health, shield, energy] = shares(unit, nature).map(f64::from);
        let bars = [
            ("health", health, 1.0),
            ("shield", shield, nature.shield),
            ("energy", energy, nature.energy),
        ];
        let bars = bars.into_iter().filter(|(.., most)| *most > 0.0);
        Disc {
            name: if is_ally { number.to_string() } else { lettered(number - battle.allies) },
            kind: TYPE_NAMES[unit.kind()],
            outline: OUTLINES[unit.kind()],
            colour: if is_ally { Some(0) } else { Some(1 + if army == NOBODY { 0 } else { army }) },
            place: unit.is_alive().then(|| unit.place.map(f64::from)),
            radius: Some(f64::from(nature.radius)),
            bars: bars.map(|(name, share, _)| Bar { name, share }).collect(),
            status: if unit.is_alive() { String::new() } else { "dead".into() },
            task: (army != NOBODY).then_some(army.into()),
            ..Disc::default()
        }
    };
    let fights = living.filter(|(_, unit)| unit.is_alive()).filter_map(|(from, unit)| {
        let (name, to) = match unit.order {
            Order::Attack(other) => ("attacks", other),
            Order::Heal(other) => ("heals", other),
            Order::Advance(_) => ("attacks", unit.target),
            Order::Stop | Order::Go(_) => return None,
        };
        let is_there = battle.units.get(usize::from(to)).is_some_and(|other| other.is_alive());
        is_there.then_some(Link { name, from, to: to.into() })
    });
    let side = f64::from(book.side);
    Picture {
        field: Some(Field { from: [0.0, side], to: [side, 0.0], cell: 1.0, is_grid: false }),
        cells: Vec::new(),
        agents: (0..battle.allies).map(disc).collect(),
        things: (battle.allies..battle.count).map(disc).collect(),
        links: fights.collect(),
    }
}
