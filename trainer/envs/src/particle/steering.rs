//! What scripted teams share: who goes where, and by which action.

use alloc::vec::Vec;

use super::physics::{ACTIONS, Body, DIRECTIONS, KEPT, Mover, STEP};
use super::plane::{Point, plus, squared_distance, times};

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
