//! Where everybody should go, by a script that knows the world and by potentials that shape rewards.

use super::world::Hoard;
use super::{BANK, COLLECTOR, TreasureCollection};
use crate::particle::plane::{Point, distance, squared_distance};
use crate::particle::steering::{pair_nearest, towards};

/// Half of the line, through the middle of the square, along which banks wait.
const LINE: f64 = 0.6;
/// Most that a free collector without a treasure, or a bank without a holder, is away from what it waits for.
const NO_TREASURE: f64 = 2.0;
const NO_HOLDER: f64 = 1.0;

impl TreasureCollection {
    /// Writes everybody's action.
    ///
    /// Free collectors go to treasures, nearest pairs first, holders to their bank, banks to the nearest holder of
    /// their kind.
    pub(super) fn collect(&self, world: &Hoard, actions: &mut [u16]) {
        let place = |agent: usize| world.movers[agent].position;
        let free = (0..self.collectors).filter(|collector| world.hands[*collector].now.is_none());
        let lie = world.treasures.iter().enumerate().filter(|(_, treasure)| treasure.is_alive());
        let pairs = pair_nearest(
            free.map(|collector| (collector, place(collector))).collect(),
            lie.map(|(number, treasure)| (number, treasure.position)).collect(),
        );
        actions[..self.collectors].fill(0);
        for (collector, treasure) in pairs {
            let goal = world.treasures[treasure].position;
            actions[collector] = towards(&COLLECTOR, &world.movers[collector], goal);
        }
        for (collector, hand) in world.hands.iter().enumerate() {
            if let Some(kind) = hand.now {
                let goal = place(self.bank_of(kind));
                actions[collector] = towards(&COLLECTOR, &world.movers[collector], goal);
            }
        }
        for kind in 0..self.banks() as u8 {
            let bank = self.bank_of(kind);
            let goal = self.nearest_holder(world, kind).unwrap_or_else(|| self.waiting_place(kind));
            actions[bank] = towards(&BANK, &world.movers[bank], goal);
        }
    }

    /// Where the nearest holder of a bank's kind is.
    fn nearest_holder(&self, world: &Hoard, kind: u8) -> Option<Point> {
        let own = world.movers[self.bank_of(kind)].position;
        let holders = world.hands.iter().zip(&world.movers);
        let holders = holders.filter(|(hand, _)| hand.now == Some(kind));
        let apart = |place: &Point| squared_distance(own, *place);
        holders
            .map(|(_, mover)| mover.position)
            .min_by(|one, other| apart(one).total_cmp(&apart(other)))
    }

    /// Banks wait side by side, each in the middle of its share of the line.
    fn waiting_place(&self, kind: u8) -> Point {
        let share = (2.0 * f64::from(kind) + 1.0) / self.banks() as f64;
        [LINE * (share - 1.0), 0.0]
    }

    /// How far an agent is from what it should be at next.
    pub(super) fn missing(&self, world: &Hoard, agent: usize) -> f64 {
        let own = world.movers[agent].position;
        let Some(hand) = world.hands.get(agent) else {
            let kind = (agent - self.collectors) as u8;
            let holder = self.nearest_holder(world, kind);
            return holder.map_or(NO_HOLDER, |holder| distance(own, holder).min(NO_HOLDER));
        };
        if let Some(kind) = hand.now {
            return distance(own, world.movers[self.bank_of(kind)].position);
        }
        let lie = world.treasures.iter().filter(|treasure| treasure.is_alive());
        let apart = lie.map(|treasure| distance(own, treasure.position));
        apart.fold(NO_TREASURE, f64::min)
    }
}
