//! Which teams at a building are shown, with what they are worth.

use alloc::vec::Vec;

use sortie_envs::members;

use super::data::TeamValues;
use crate::thoughts::rounded;

/// Other teams that are shown.
const OTHERS: usize = 3;
/// Most agents for which all teams are compared; beyond, those that differ in one agent.
const ALL_TEAMS: usize = 8;

/// Nobody, the chosen team, and others of the first so many agents that the allocator may give; bit a stands for agent a.
pub fn candidates(agents: usize, team_max: usize, chosen: u64) -> Vec<u64> {
    let fits = |team: &u64| team.count_ones() as usize <= team_max;
    let mut teams: Vec<u64> = if agents <= ALL_TEAMS {
        (0..1 << agents).filter(fits).collect()
    } else {
        (0..agents).map(|agent| chosen ^ 1 << agent).filter(fits).collect()
    };
    teams.extend([0, chosen]);
    teams.sort_unstable();
    teams.dedup();
    teams
}

impl TeamValues {
    /// What is shown of teams and their values: the chosen one, nobody, and the best others.
    pub fn of(teams: &[u64], values: &[f32], chosen: u64) -> Self {
        let mut others = Vec::new();
        let (mut own, mut nobody) = (0.0, 0.0);
        for (&team, &value) in teams.iter().zip(values) {
            if team == 0 {
                nobody = rounded(value);
            }
            if team == chosen {
                own = rounded(value);
            } else if team != 0 {
                others.push((members(team.into()).collect(), rounded(value)));
            }
        }
        others.sort_by(|(_, one): &(Vec<usize>, f64), (_, other)| other.total_cmp(one));
        others.truncate(OTHERS);
        Self { chosen: own, nobody, others }
    }
}
