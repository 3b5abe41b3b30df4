//! Teams at their buildings, written as input of the utility network.
//!
//! The subtask mask of ALMA lets an agent see its own team and its own building only (dissertation
//! section 7.3), so a team with its building is a complete sample.

use sortie_envs::save_the_city::{
    ACTIONS, AgentState, BuildingState, City, FEATURES, agent_features, building_features,
};

use super::utility_pass::UtilityInput;

/// Columns of the utility network's input: an entity's features and its last action's one-hot.
pub const INPUT_COLUMNS: usize = FEATURES + ACTIONS;

/// The last action of an agent that has not acted yet in its episode.
pub const NO_ACTION: u8 = u8::MAX;

/// Any number of teams, each with the building that it is assigned to.
#[derive(Clone, Debug, Default)]
pub struct TeamBatch {
    input: UtilityInput,
    /// Agents in all teams up to each.
    ends: Vec<u32>,
    buildings: Vec<BuildingState>,
}

impl TeamBatch {
    /// Forgets all teams, keeps the memory.
    pub fn clear(&mut self) {
        self.input.clear();
        self.ends.clear();
        self.buildings.clear();
    }

    /// Adds an agent to the team that the next [`end_team`](Self::end_team) closes.
    pub fn push_agent(&mut self, agent: &AgentState, last_action: u8) {
        let rows = &mut self.input.rows;
        agent_features(agent, |column, value| rows.push(column, value));
        if last_action != NO_ACTION {
            rows.push(FEATURES + usize::from(last_action), 1.0);
        }
        rows.end_row();
    }

    /// Closes a team. Its agents see each other and the building.
    pub fn end_team(&mut self, building: &BuildingState) {
        self.ends.push(self.input.rows.len() as u32);
        self.buildings.push(*building);
    }

    /// Adds every team of a city. `added` is told the agents in the order of their rows.
    pub fn push_teams(
        &mut self,
        city: City<'_>,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        for (task, building) in city.buildings.iter().enumerate() {
            let rows = self.input.rows.len();
            for (agent, state) in city.agents.iter().enumerate() {
                if usize::from(allocation[agent]) == task {
                    self.push_agent(state, last_actions[agent]);
                    added(agent);
                }
            }
            if self.input.rows.len() > rows {
                self.end_team(building);
            }
        }
    }

    /// Adds the agents of a city that have no building, once all teams have been added.
    pub fn push_unassigned(
        &mut self,
        city: City<'_>,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        for (agent, state) in city.agents.iter().enumerate() {
            if usize::from(allocation[agent]) >= city.buildings.len() {
                self.push_agent(state, last_actions[agent]);
                added(agent);
            }
        }
    }

    /// Writes the buildings' rows and what each agent sees. No team may be added afterwards.
    ///
    /// Agents after the last closed team have no building and see nothing.
    pub fn finish(&mut self) -> &UtilityInput {
        let UtilityInput { rows, visible } = &mut self.input;
        let agents = rows.len();
        let mut first = 0;
        for (team, (building, end)) in self.buildings.iter().zip(&self.ends).enumerate() {
            building_features(building, |column, value| rows.push(column, value));
            rows.end_row();
            let members = first..*end as usize;
            first = members.end;
            for _ in members.clone() {
                members.clone().for_each(|row| visible.push(row));
                visible.push(agents + team);
                visible.end_list();
            }
        }
        (first..agents).for_each(|_| visible.end_list());
        &self.input
    }

    /// The input as [`finish`](Self::finish) left it.
    pub fn input(&self) -> &UtilityInput {
        &self.input
    }
}

/// The available action of highest utility, the lowest index on ties.
///
/// `available` has bit u set where action u is available; some bit within `utilities` must be set.
pub fn best_action(utilities: &[f32], available: u16) -> u8 {
    let mut best = (f32::NEG_INFINITY, available.trailing_zeros() as u8);
    for (action, utility) in utilities.iter().enumerate() {
        if available >> action & 1 == 1 && *utility > best.0 {
            best = (*utility, action as u8);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_envs::save_the_city::{AgentKind, BuildingKind, Status};

    fn building() -> BuildingState {
        BuildingState {
            health: 0.5,
            fire: 0.0,
            period: 20,
            to_next_fire: 12,
            since_last_fire: 8,
            kind: BuildingKind::Slow,
            status: Status::Open,
            x: 4,
            y: 7,
        }
    }

    #[test]
    fn agents_see_their_team_and_building_only() {
        let agent = |x| AgentState::at(AgentKind::Builder, x, 2);
        let mut batch = TeamBatch::default();
        batch.push_agent(&agent(1), NO_ACTION);
        batch.push_agent(&agent(2), 3);
        batch.end_team(&building());
        batch.push_agent(&agent(3), NO_ACTION);
        batch.end_team(&building());
        batch.push_agent(&agent(4), NO_ACTION);
        let input = batch.finish();

        assert_eq!(input.rows.len(), 6);
        let lists = |query| input.visible.list(query).collect::<Vec<_>>();
        assert_eq!(lists(0), [0, 1, 4]);
        assert_eq!(lists(1), [0, 1, 4]);
        assert_eq!(lists(2), [2, 5]);
        assert!(lists(3).is_empty());
        let last_actions =
            |row| input.rows.row(row).filter(|(c, _)| *c >= FEATURES).collect::<Vec<_>>();
        assert!(last_actions(0).is_empty());
        assert_eq!(last_actions(1), [(FEATURES + 3, 1.0)]);
    }

    #[test]
    fn the_best_available_action_is_the_first_of_equals() {
        assert_eq!(best_action(&[1.0, 3.0, 3.0, 9.0], 0b0111), 1);
        assert_eq!(best_action(&[1.0, f32::NAN], 0b10), 1);
    }
}
