//! Value decomposition by a sum (VDN): what the team is worth is what its agents are worth together.

use super::Team;

pub(super) fn value(team: Team, utilities: &[f32], imagined: bool) -> f32 {
    team.inputs(imagined).map(|row| utilities[row]).sum()
}

pub(super) fn descend(team: Team, imagined: bool, slope: f32, d_utilities: &mut [f32]) {
    team.inputs(imagined).for_each(|row| d_utilities[row] = slope);
}
