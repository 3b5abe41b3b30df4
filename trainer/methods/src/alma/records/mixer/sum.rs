//! Value decomposition by a sum (VDN): what the team is worth is what its agents are worth together.

use super::Teams;

/// Writes the value of every team.
pub(super) fn forward(teams: Teams<'_>, values: &mut [f32]) {
    for ((_, utilities), value) in teams.each().zip(values) {
        *value = utilities.iter().sum();
    }
}

/// Writes the slope by every utility.
pub(super) fn backward(teams: Teams<'_>, d_values: &[f32], d_utilities: &mut [f32]) {
    for ((team, _), d_value) in teams.each().zip(d_values) {
        d_utilities[team].fill(*d_value);
    }
}
