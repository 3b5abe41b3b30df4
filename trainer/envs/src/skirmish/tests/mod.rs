//! Skirmishes against their rule book and recorded fights.

mod fighting;
mod golden;
mod laws;
mod moving;
mod reflexes;
mod scripts;

use super::battle::{Battle, Order, Point};
use super::units::Book;
use crate::random::generator;

/// A unit of a type at a place.
type Placed = (u8, Point);

/// A battle of units at these places, all of whom stop.
fn battle(book: &Book, allies: &[Placed], enemies: &[Placed]) -> Battle {
    let kinds = |team: &[Placed]| team.iter().map(|(kind, _)| *kind).collect::<Vec<_>>();
    let mut battle = Battle::of(book, &kinds(allies), &kinds(enemies));
    let places = allies.iter().chain(enemies).map(|(_, place)| *place);
    battle.units.iter_mut().zip(places).for_each(|(unit, place)| unit.place = place);
    battle
}

/// The rules without chance.
fn liberty() -> Book {
    Book { jitter: None, ..Book::liberty() }
}

fn ticks(book: &Book, battle: &mut Battle, count: usize) {
    (0..count).for_each(|_| battle.tick(book, &mut generator(0)));
}

/// Ticks until something is so, at most 200.
fn until(book: &Book, battle: &mut Battle, is_so: impl Fn(&Battle) -> bool) -> usize {
    for count in 1..=200 {
        battle.tick(book, &mut generator(0));
        if is_so(battle) {
            return count;
        }
    }
    panic!("it never is so: {:?}", &battle.units[..battle.count]);
}

/// Gives orders to units, by their numbers.
fn order(battle: &mut Battle, orders: &[(usize, Order)]) {
    orders.iter().for_each(|(unit, order)| battle.units[*unit].order = *order);
}
