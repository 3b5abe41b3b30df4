//! How units stand to an army: what an allocator is told besides rows.
//!
//! How strong an army is, and how strong those who are left to meet it, are sums over units. A network that attends takes means,
//! and rows tell of one unit at a time: the sums have to be told.

use super::battle::{Point, length};

/// Columns: the way to an army's middle east and north, its length, how much of the army is left, and how much of all agents.
pub(super) const RELATIONS: usize = 5;
/// Units of a large team, which strength is told in shares of.
const LARGE_TEAM: f32 = 8.0;

/// What rows show of a unit that lives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Glimpse {
    /// The army of an enemy; none of agents.
    pub(super) army: Option<usize>,
    /// From -1 to 1 on both axes; the base is zero.
    pub(super) place: Point,
    /// Shares of life and shield together, from 0 to 2.
    pub(super) body: f32,
}

/// An army, as far as agents stand to it somehow.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opposed {
    /// Its first unit, which asks: nothing is told of it.
    first: usize,
    middle: Point,
    /// What is left of the army, and of all agents, as shares of a large team.
    left: [f32; 2],
}

impl Opposed {
    /// Of all units that live, by their numbers; none where nothing of the army is left.
    pub(super) fn of(units: impl Iterator<Item = (usize, Glimpse)>, army: usize) -> Option<Self> {
        let (mut first, mut sum, mut count, mut bodies) = (None, [0.0; 2], 0.0, [0.0; 2]);
        for (number, unit) in units {
            match unit.army {
                Some(own) if own == army => {
                    first.get_or_insert(number);
                    sum = [0, 1].map(|part| sum[part] + unit.place[part]);
                    count += 1.0;
                    bodies[0] += unit.body;
                }
                Some(_) => {}
                None => bodies[1] += unit.body,
            }
        }
        let left = bodies.map(|body| body / LARGE_TEAM);
        first.map(|first| Self { first, middle: sum.map(|part| part / count), left })
    }

    /// How the unit of a number stands to it.
    pub(super) fn relation(&self, number: usize, unit: &Glimpse) -> [f32; RELATIONS] {
        if number == self.first {
            return [0.0; RELATIONS];
        }
        let [east, north] = [0, 1].map(|part| self.middle[part] - unit.place[part]);
        let [army, agents] = self.left;
        [east, north, length([east, north]), army, agents]
    }
}
