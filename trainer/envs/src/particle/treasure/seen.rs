//! What collectors and banks see: themselves, the nearest others, the nearest treasures.

use alloc::format;
use alloc::vec;
use alloc::vec::Vec;

use super::world::Hoard;
use super::{DeadTreasures, TreasureCollection};
use crate::particle::columns::{Names, Row};
use crate::particle::physics::MOVES;
use crate::particle::plane::{Nearest, SEEN, from_to};
use crate::spec::Role;

impl TreasureCollection {
    pub(super) fn named_roles(&self) -> Vec<Role> {
        let (agents, kinds) = (self.agents(), self.banks());
        let other = |names: Names, other: &str| {
            let names = names.place(other).velocity(other);
            names.flags(&format!("{other}bank-"), kinds).flags(&format!("{other}holds-"), kinds)
        };
        let treasure = |names: Names, treasure: &str| {
            names.place(treasure).flags(&format!("{treasure}kind-"), kinds)
        };
        let own = || Names::default().place("").velocity("");
        let around = |own: Names| {
            own.each("other", SEEN.min(agents - 1), other).each(
                "treasure",
                SEEN.min(self.treasures()),
                treasure,
            )
        };
        vec![
            around(own().flags("holds-", kinds)).role("collector", 0..self.collectors, &MOVES),
            around(own()).role("bank", self.collectors..agents, &MOVES),
        ]
    }

    pub(super) fn see(&self, world: &Hoard, agent: usize, row: &mut Row<'_>) {
        let (own, kinds) = (&world.movers[agent], self.banks());
        row.mover(own);
        if let Some(hand) = world.hands.get(agent) {
            row.flags(hand.seen, kinds);
        }
        let others = world.movers.iter().map(|mover| mover.position).enumerate();
        let others = Nearest::to(own.position, others.filter(|(other, _)| *other != agent));
        for other in others.things() {
            let mover = &world.movers[other];
            row.pair(from_to(own.position, mover.position));
            row.pair(mover.velocity);
            row.flags(other.checked_sub(self.collectors).map(|bank| bank as u8), kinds);
            row.flags(world.hands.get(other).and_then(|hand| hand.seen), kinds);
        }
        let treasures = world.treasures.iter().map(|treasure| treasure.seen_place());
        for treasure in Nearest::to(own.position, treasures.enumerate()).things() {
            let treasure = &world.treasures[treasure];
            if treasure.is_seen_dead() && self.dead_treasures == DeadTreasures::Zeros {
                row.skip(2 + kinds);
            } else {
                row.pair(from_to(own.position, treasure.seen_place()));
                row.flags(Some(treasure.seen_kind()), kinds);
            }
        }
    }
}
