//! Points of the plane, and what is nearest.

use crate::random::{Random, unit};

/// A place or a direction, in half sides of the square that everything starts in.
pub type Point = [f64; 2];

/// The way from one place to another.
#[inline]
pub(super) fn from_to(from: Point, to: Point) -> Point {
    [to[0] - from[0], to[1] - from[1]]
}

/// A direction so many times as long.
#[inline]
pub(super) fn times(factor: f64, way: Point) -> Point {
    [factor * way[0], factor * way[1]]
}

/// Two directions, one behind the other.
#[inline]
pub(super) fn plus(one: Point, other: Point) -> Point {
    [one[0] + other[0], one[1] + other[1]]
}

/// The square of a length, which compares as the length does.
#[inline]
pub(super) fn squared(way: Point) -> f64 {
    way[0] * way[0] + way[1] * way[1]
}

#[inline]
pub(super) fn squared_distance(one: Point, other: Point) -> f64 {
    squared(from_to(one, other))
}

pub(super) fn distance(one: Point, other: Point) -> f64 {
    libm::sqrt(squared_distance(one, other))
}

/// A place in the square of this half side.
pub(super) fn anywhere(random: &mut Random, half: f64) -> Point {
    [(); 2].map(|()| half * (2.0 * unit(random) - 1.0))
}

/// Most things that an agent sees of a kind.
pub(super) const SEEN: usize = 7;

/// The nearest things with their squared distances, nearest first; of equally near ones the first.
pub(super) struct Nearest {
    found: [(f64, usize); SEEN],
    count: usize,
}

impl Nearest {
    /// The nearest of these things, at most [`SEEN`].
    pub(super) fn to(own: Point, things: impl Iterator<Item = (usize, Point)>) -> Self {
        let mut nearest = Self { found: [(0.0, 0); SEEN], count: 0 };
        things.for_each(|(thing, place)| nearest.add(squared_distance(own, place), thing));
        nearest
    }

    fn add(&mut self, squared: f64, thing: usize) {
        if self.count < SEEN {
            self.count += 1;
        } else if squared >= self.found[SEEN - 1].0 {
            return;
        }
        let mut at = self.count - 1;
        while at > 0 && self.found[at - 1].0 > squared {
            self.found[at] = self.found[at - 1];
            at -= 1;
        }
        self.found[at] = (squared, thing);
    }

    /// Their numbers.
    pub(super) fn things(&self) -> impl ExactSizeIterator<Item = usize> {
        self.found[..self.count].iter().map(|(_, thing)| *thing)
    }
}
