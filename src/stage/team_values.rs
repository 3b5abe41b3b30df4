//! What an allocator that has learned to value teams expects of those at one subtask.

use alloc::vec::Vec;

use serde::Serialize;
use sortie_envs::members;

use crate::thoughts::rounded;

/// What the allocator expects of teams at one subtask.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TeamValues {
    /// Of the team that is there.
    pub chosen: f64,
    /// Of nobody.
    pub nobody: f64,
    /// The most valuable other teams, best first: their agents and their value.
    pub others: Vec<(Vec<usize>, f64)>,
}

/// Other teams that are shown.
const OTHERS: usize = 3;
/// Most agents for which all teams are compared; beyond, those that differ in one agent.
const ALL_TEAMS: usize = 8;

impl TeamValues {
    /// What is shown of teams and their values: the chosen one, nobody, and the best others.
    pub(crate) fn of(teams: &[u64], values: &[f32], chosen: u64) -> Self {
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

/// Nobody, the chosen team, and others of the first so many agents that the allocator may give; bit a stands for agent a.
pub(crate) fn candidates(agents: usize, team_max: usize, chosen: u64) -> Vec<u64> {
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

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeMap;
    use alloc::vec;

    use sortie_envs::random::generator;
    use sortie_envs::{Split, UNASSIGNED, open};

    use super::*;
    use crate::show::{Glance, Shown};

    /// Some value of a team at a subtask, of which no two are alike.
    fn value(task: usize, team: u64) -> f32 {
        (team as f32 + 0.5).sin() + task as f32
    }

    #[test]
    fn values_are_those_of_the_teams_that_are_named() {
        let world = open("save-the-city/2-8a_2-8b", Split::Train, 1, &BTreeMap::new());
        let mut world = world.expect("it opens");
        world.reset(0, &mut generator(3));
        let mut shown = Shown::at(Glance { worlds: &*world, instance: 0 });
        // The network is asked about open subtasks only; this one is said not to be.
        shown.open_tasks &= !0b10;
        let agents = shown.state.agents.len();
        let mut allocation = vec![0; agents];
        allocation[0] = UNASSIGNED;
        shown.assign(&allocation, true);

        let ask = |task, teams: &[u64]| {
            assert_ne!(task, 1, "nobody asks about closed subtasks");
            let known = teams.iter().map(|team| value(task, *team));
            Ok::<_, ()>(known.collect())
        };
        let values = shown.team_values(2, 0, ask).expect("it answers");
        assert_eq!(values.len(), shown.state.things.len());
        assert!(values[1].is_none(), "closed subtasks have no value");
        let everybody_else = (1 << agents) - 2;
        for (task, chosen) in [(0, everybody_else), (2, 0)] {
            let found = values[task].as_ref().expect("values");
            assert_eq!(found.chosen, rounded(value(task, chosen)));
            assert_eq!(found.nobody, rounded(value(task, 0)));
            assert!(found.others.is_sorted_by(|one, other| one.1 >= other.1));
            assert!(!found.others.is_empty());
            for (agents, known) in &found.others {
                assert!(agents.len() <= 2, "no team over the limit");
                let team = agents.iter().fold(0, |team, agent| team | 1 << agent);
                assert_eq!(*known, rounded(value(task, team)));
            }
        }
    }
}
