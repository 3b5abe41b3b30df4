//! Values one by one, for tests: what networks make of a state alone.

use super::replay::{Place, Replay};
use crate::pictures::{Heads, Learner, Shown, Space};

/// The values of a head's actions in a state by some weights.
pub(crate) fn values(
    (learner, weights, heads): (&Learner, &[f32], Heads),
    (replay, shown): (&Replay, &Shown),
    (place, is_mirrored, goal): (Place, bool, usize),
) -> Vec<f32> {
    let state = [(replay.shown(place), is_mirrored)];
    let (mut space, mut values) = (Space::default(), Vec::new());
    let hidden = space.hidden(&learner.network, weights, shown, state.into_iter());
    heads.values(&learner.network, weights, hidden, goal, &mut values);
    values
}

/// The first of the largest numbers.
pub(crate) fn greedy(values: &[f32]) -> usize {
    (0..values.len()).rev().max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap()
}
