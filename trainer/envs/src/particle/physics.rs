//! How agents move: thrust, contact, damping. Everything that moves is a disc.

use super::plane::{Point, from_to, plus, squared, times};

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
pub(super) const KEPT: f64 = 0.75;
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
