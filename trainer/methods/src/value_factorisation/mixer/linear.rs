//! The linear mixer: `Q = sum of w_a q_a + V`.
//!
//! `w` is a softmax, over all that is mixed, of the hypernetwork's first number, and `V` the mean of its
//! second over the team.

use super::Team;

/// Numbers for each agent: what its utility is weighted by, and what the state is worth.
pub(super) const KINDS: [(&str, usize); 2] = [("weights", 1), ("value", 1)];
const OUTPUTS: usize = 2;

/// The largest score of what is mixed, and the sum of `exp(score - largest)`.
fn mass(team: Team, numbers: &[f32], imagined: bool) -> (f32, f32) {
    let scores = team.inputs(imagined).map(|row| numbers[row * OUTPUTS]);
    let largest = scores.clone().fold(f32::NEG_INFINITY, f32::max);
    (largest, scores.map(|score| exp(score - largest)).sum())
}

/// The weight of every row that is mixed.
fn weights(
    team: Team,
    numbers: &[f32],
    imagined: bool,
) -> impl Iterator<Item = (usize, f32)> + Clone {
    let (largest, sum) = mass(team, numbers, imagined);
    team.inputs(imagined).map(move |row| (row, exp(numbers[row * OUTPUTS] - largest) / sum))
}

fn exp(x: f32) -> f32 {
    sortie_core::internal::math::exp(x)
}

pub(super) fn value(team: Team, numbers: &[f32], utilities: &[f32], imagined: bool) -> f32 {
    let mixed: f32 = weights(team, numbers, imagined).map(|(row, w)| w * utilities[row]).sum();
    let state: f32 = team.rows(0).map(|row| numbers[row * OUTPUTS + 1]).sum();
    mixed + state / team.size.max(1) as f32
}

pub(super) fn descend(
    team: Team,
    imagined: bool,
    slope: f32,
    (numbers, utilities): (&[f32], &[f32]),
    (d_numbers, d_utilities): (&mut [f32], &mut [f32]),
) {
    let weights = weights(team, numbers, imagined);
    let mixed: f32 = weights.clone().map(|(row, w)| w * utilities[row]).sum();
    for (row, weight) in weights {
        d_utilities[row] = slope * weight;
        d_numbers[row * OUTPUTS] += slope * weight * (utilities[row] - mixed);
    }
    let share = slope / team.size.max(1) as f32;
    team.rows(0).for_each(|row| d_numbers[row * OUTPUTS + 1] += share);
}
