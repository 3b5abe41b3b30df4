//! Points of the plane, and how agents move: thrust, contact, damping. Everything that moves is a disc.

use alloc::vec::Vec;

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
        let mut things = things.map(|(thing, place)| (squared_distance(own, place), thing));
        let mut first = [(f64::INFINITY, 0); SEEN];
        let mut count = 0;
        for (slot, thing) in first.iter_mut().zip(things.by_ref()) {
            *slot = thing;
            count += 1;
        }
        let mut nearest = Self { found: sorted(&first), count };
        things.for_each(|(squared, thing)| nearest.add(squared, thing));
        nearest
    }

    /// Adds one to as many as there may be.
    fn add(&mut self, squared: f64, thing: usize) {
        let mut at = SEEN;
        while at > 0 && self.found[at - 1].0 > squared {
            if at < SEEN {
                self.found[at] = self.found[at - 1];
            }
            at -= 1;
        }
        if at < SEEN {
            self.found[at] = (squared, thing);
        }
    }

    /// Their numbers.
    pub(super) fn things(&self) -> impl ExactSizeIterator<Item = usize> {
        self.found[..self.count].iter().map(|(_, thing)| *thing)
    }
}

/// Puts each behind those that are nearer, and behind those equally near that stand before it. It counts them: which thing
/// is nearer is as good as random, so that a processor would guess wrong at every other branch.
fn sorted(things: &[(f64, usize); SEEN]) -> [(f64, usize); SEEN] {
    // What is squared compares as its bits do.
    let squared = things.map(|(squared, _)| squared.to_bits());
    let mut before = [0; SEEN];
    for number in 0..SEEN {
        for other in number + 1..SEEN {
            let is_nearer = usize::from(squared[other] < squared[number]);
            before[number] += is_nearer;
            before[other] += 1 - is_nearer;
        }
    }
    let mut sorted = *things;
    for (before, thing) in before.iter().zip(things) {
        sorted[*before] = *thing;
    }
    sorted
}

/// Actions of every agent, of those that move and of those that speak.
pub const ACTIONS: usize = 5;
/// What the actions of an agent that moves are called: the directions of its thrust.
pub const MOVES: [&str; ACTIONS] = ["none", "right", "left", "up", "down"];
/// Where they push.
pub(super) const DIRECTIONS: [Point; ACTIONS] =
    [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];

/// Time of one step.
pub(super) const STEP: f64 = 0.1;
/// Share of the velocity that a step leaves.
const KEPT: f64 = 0.75;
/// Force of a contact, per length that two discs lie in each other.
const STIFFNESS: f64 = 100.0;
/// Length over which a contact sets in.
const MARGIN: f64 = 0.001;
/// From this gap on a contact's force, below 4e-19, is left out.
const GAP: f64 = 0.04;

/// Where an agent is and how fast it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mover {
    /// In half sides of the square.
    pub position: Point,
    /// In half sides in ten steps.
    pub velocity: Point,
}

/// What an agent is as a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Of its disc.
    pub radius: f64,
    /// A contact pushes by its force times the mass of the other over the own.
    pub mass: f64,
    /// Acceleration of its own actions.
    pub thrust: f64,
    /// No faster than that.
    pub max_speed: f64,
    /// Whether it pushes, and is pushed by, others that do.
    pub collides: bool,
}

/// Whether two things of these radii touch.
#[inline]
pub(super) fn touch(reach: f64, squared_distance: f64) -> bool {
    squared_distance < reach * reach
}

/// Moves everybody for one step.
///
/// A contact of two bodies pushes each by its force times the other's mass over the own, as in the reference:
/// momentum is not kept where masses differ. Bodies in the very same place do not push each other.
pub(super) fn advance(movers: &mut [Mover], bodies: &[Body], actions: &[u16]) {
    for agent in 0..movers.len() {
        let body = &bodies[agent];
        let thrust = times(body.mass * body.thrust, DIRECTIONS[usize::from(actions[agent])]);
        let force = if body.collides { pushed(thrust, agent, movers, bodies) } else { thrust };
        let mover = &mut movers[agent];
        mover.velocity = accelerated(body, mover.velocity, force);
    }
    for mover in movers {
        mover.position = plus(mover.position, times(STEP, mover.velocity));
    }
}

/// Adds the forces of all contacts of an agent.
fn pushed(thrust: Point, agent: usize, movers: &[Mover], bodies: &[Body]) -> Point {
    let (own, body) = (movers[agent].position, &bodies[agent]);
    let mut force = thrust;
    for (other, (mover, its)) in movers.iter().zip(bodies).enumerate() {
        let way = from_to(mover.position, own);
        let (squared, reach) = (squared(way), body.radius + its.radius);
        if other != agent && its.collides && touch(reach + GAP, squared) && squared > 0.0 {
            let distance = libm::sqrt(squared);
            let inside = MARGIN * softplus((reach - distance) / MARGIN);
            let push = |way: f64| its.mass / body.mass * (STIFFNESS * way / distance * inside);
            force = plus(force, way.map(push));
        }
    }
    force
}

/// ln(1 + eˣ).
fn softplus(x: f64) -> f64 {
    x.max(0.0) + libm::log1p(libm::exp(-x.abs()))
}

#[inline]
fn accelerated(body: &Body, velocity: Point, force: Point) -> Point {
    let [x, y] = [0, 1].map(|axis| velocity[axis] * KEPT + force[axis] / body.mass * STEP);
    let squared = squared([x, y]);
    if squared <= body.max_speed * body.max_speed {
        return [x, y];
    }
    let speed = libm::sqrt(squared);
    [x, y].map(|part| part / speed * body.max_speed)
}

/// Steps that a script looks ahead, at the velocity that the first of them gives.
const AHEAD: f64 = 2.0;

/// The action that leads nearest to a place.
pub(super) fn towards(body: &Body, mover: &Mover, place: Point) -> u16 {
    let missing = |action: usize| {
        let gained = times(STEP * body.thrust, DIRECTIONS[action]);
        let velocity = plus(times(KEPT, mover.velocity), gained);
        squared_distance(plus(mover.position, times(AHEAD * STEP, velocity)), place)
    };
    let nearer = |best: usize, action| if missing(action) < missing(best) { action } else { best };
    (1..ACTIONS).fold(0, nearer) as u16
}

/// Pairs the nearest two by their numbers, then the nearest of those that are left, until one side is used up.
pub(super) fn pair_nearest(
    mut ones: Vec<(usize, Point)>,
    mut others: Vec<(usize, Point)>,
) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    while !ones.is_empty() && !others.is_empty() {
        let places =
            (0..ones.len()).flat_map(|one| (0..others.len()).map(move |other| (one, other)));
        let apart =
            |(one, other): &(usize, usize)| squared_distance(ones[*one].1, others[*other].1);
        let nearest = places.min_by(|pair, next| apart(pair).total_cmp(&apart(next)));
        let (one, other) = nearest.expect("both sides have somebody");
        pairs.push((ones.remove(one).0, others.remove(other).0));
    }
    pairs
}
