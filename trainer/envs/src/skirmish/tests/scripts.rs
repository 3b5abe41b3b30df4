//! Teams led by fixed rules, as those of recorded fights were.

use serde::Deserialize;

use super::super::battle::{Battle, Order, Point, each, length};
use super::super::units::{Book, MEDIVAC};

/// How far agents shoot and heal, from centre to centre, and how far an order to walk leads.
const REACH: f32 = 6.0;
const STRIDE: f32 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Script {
    /// Attacks the nearest within reach, and goes to the nearest else.
    Closest,
    /// Attacks the weakest within reach, and goes to the nearest else.
    Focus,
    /// Attacks the nearest within reach, and stands else.
    Hold,
    /// Steps back from who is near while its weapon is not ready, and does as `Closest` else.
    Kite,
}

impl Script {
    /// Tells all allies what to do.
    pub(super) fn lead(self, book: &Book, battle: &mut Battle) {
        for ally in each(battle.living()[0]) {
            let order = if battle.units[ally].kind == MEDIVAC {
                tend(battle, book, ally)
            } else {
                self.order(book, battle, ally)
            };
            battle.units[ally].order = order;
        }
    }

    fn order(self, book: &Book, battle: &Battle, ally: usize) -> Order {
        let unit = &battle.units[ally];
        let can_hit = |foe: &usize| book.can_hit(unit.kind(), battle.units[*foe].kind());
        let foes: Vec<usize> = each(battle.living()[1]).filter(can_hit).collect();
        let distance = |foe: usize| battle.distance(ally, foe);
        let Some(nearest) = first_least(foes.iter().copied(), distance) else { return Order::Stop };
        let is_near = battle.gap(book, ally, nearest) < 3.0;
        if self == Self::Kite && unit.cooldown > 0.0 && is_near {
            return stride(unit.place, battle.way(nearest, ally));
        }
        let within = foes.iter().copied().filter(|foe| distance(*foe) <= REACH);
        let health = |foe: usize| battle.units[foe].life + battle.units[foe].shield;
        let target = match self {
            Self::Focus => first_least(within, health),
            _ => first_least(within, distance),
        };
        match target {
            Some(target) => Order::Attack(target as u8),
            None if self == Self::Hold => Order::Stop,
            None => stride(unit.place, battle.way(ally, nearest)),
        }
    }
}

/// Heals the weakest within reach, and goes to the middle of its comrades else.
fn tend(battle: &Battle, book: &Book, medivac: usize) -> Order {
    let comrades = battle.living()[0] & !(1 << medivac);
    let share = |unit: usize| battle.units[unit].life / book.types[battle.units[unit].kind()].life;
    let patients = each(comrades).filter(|unit| {
        let is_near = battle.distance(medivac, *unit) <= REACH;
        battle.units[*unit].kind != MEDIVAC && is_near && share(*unit) < 1.0
    });
    if let Some(patient) = first_least(patients, share) {
        return Order::Heal(patient as u8);
    }
    let count = comrades.count_ones() as f32;
    let place = battle.units[medivac].place;
    let sum = each(comrades).fold([0.0; 2], |[x, y], unit| {
        let way = battle.way(medivac, unit);
        [x + way[0], y + way[1]]
    });
    let way = sum.map(|part| part / count);
    if comrades == 0 || length(way) <= 1.0 { Order::Stop } else { stride(place, way) }
}

/// Along the axis that leads best that way: north, south, east, west.
fn stride([x, y]: Point, way: Point) -> Order {
    let ways = [[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]];
    let gain = |at: usize| -(ways[at][0] * way[0] + ways[at][1] * way[1]);
    let [east, north] = ways[first_least(0..4, gain).unwrap()];
    Order::Go([x + STRIDE * east, y + STRIDE * north])
}

fn first_least(among: impl Iterator<Item = usize>, number: impl Fn(usize) -> f32) -> Option<usize> {
    among.min_by(|one, other| number(*one).total_cmp(&number(*other)))
}
