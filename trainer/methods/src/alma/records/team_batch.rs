//! Teams and what they see, written as input of the utility network.
//!
//! The subtask mask of ALMA lets an agent see its own team and its own building only (dissertation
//! section 7.3). Without the mask an agent sees the whole city.

use sortie_envs::random::member;
use sortie_envs::save_the_city::{
    ACTIONS, AgentState, BuildingState, City, FEATURES, UNASSIGNED, agent_features,
    building_features,
};
use sortie_nn::layers::SparseRows;
use sortie_nn::random::Generator;

use super::conditioning::Conditioning;
use super::utility_pass::UtilityInput;

/// Columns of an entity's features and its last action's one-hot.
///
/// Where entities are marked with their subtask, the marks follow behind.
pub const INPUT_COLUMNS: usize = FEATURES + ACTIONS;

/// The last action of an agent that has not acted yet in its episode.
pub const NO_ACTION: u8 = u8::MAX;

/// Any number of teams, each with what its agents see.
#[derive(Clone, Debug, Default)]
pub struct TeamBatch {
    conditioning: Conditioning,
    input: UtilityInput,
    /// What the teams see besides themselves.
    others: SparseRows,
    /// Agents in all teams, and rows in `others`, up to each team's end.
    ends: Vec<(u32, u32)>,
}

impl TeamBatch {
    /// An empty batch.
    pub fn new(conditioning: Conditioning) -> Self {
        Self { conditioning, ..Self::default() }
    }

    /// Columns of a row in a city of so many subtasks.
    pub fn columns(&self, tasks: usize) -> usize {
        INPUT_COLUMNS + self.conditioning.task_columns(tasks)
    }

    /// Forgets all teams, keeps the memory.
    pub fn clear(&mut self) {
        self.input.clear();
        self.others.clear();
        self.ends.clear();
    }

    /// Adds an agent to the team that the next [`end_team`](Self::end_team) closes.
    pub fn push_agent(&mut self, agent: &AgentState, last_action: u8, task: u8) {
        write_agent(&mut self.input.rows, agent, last_action);
        mark(self.conditioning, &mut self.input.rows, task);
        self.input.rows.end_row();
    }

    /// Adds an agent that this team sees, but that is not of it.
    pub fn push_other(&mut self, agent: &AgentState, last_action: u8, task: u8) {
        write_agent(&mut self.others, agent, last_action);
        mark(self.conditioning, &mut self.others, task);
        self.others.end_row();
    }

    /// Adds a building that this team sees.
    pub fn push_building(&mut self, building: &BuildingState, task: u8) {
        building_features(building, |column, value| self.others.push(column, value));
        mark(self.conditioning, &mut self.others, task);
        self.others.end_row();
    }

    /// Closes a team. Its agents see each other and what was pushed for them.
    pub fn end_team(&mut self) {
        self.ends.push((self.input.rows.len() as u32, self.others.len() as u32));
    }

    /// Adds every team of a city. `added` is told the agents in the order of their rows.
    ///
    /// Without the subtask mask everybody sees the same, so that all agents are one team here.
    pub fn push_teams(
        &mut self,
        city: City<'_>,
        allocation: &[u8],
        last_actions: &[u8],
        added: impl FnMut(usize),
    ) {
        if self.conditioning == Conditioning::Mask {
            self.push_masked_teams(city, allocation, last_actions, added);
        } else {
            self.push_everybody(city, allocation, last_actions, added);
        }
    }

    fn push_masked_teams(
        &mut self,
        city: City<'_>,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        for (task, building) in (0..).zip(city.buildings) {
            let rows = self.input.rows.len();
            for (agent, state) in city.agents.iter().enumerate() {
                if allocation[agent] == task {
                    self.push_agent(state, last_actions[agent], task);
                    added(agent);
                }
            }
            if self.input.rows.len() > rows {
                self.push_building(building, task);
                self.end_team();
            }
        }
    }

    fn push_everybody(
        &mut self,
        city: City<'_>,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        for (agent, state) in city.agents.iter().enumerate() {
            self.push_agent(state, last_actions[agent], allocation[agent]);
            added(agent);
        }
        for (task, building) in (0..).zip(city.buildings) {
            self.push_building(building, task);
        }
        self.end_team();
    }

    /// Adds the agents of a city that are in no team, once all teams have been added.
    pub fn push_unassigned(
        &mut self,
        city: City<'_>,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        if self.conditioning != Conditioning::Mask {
            return;
        }
        for (agent, state) in city.agents.iter().enumerate() {
            if usize::from(allocation[agent]) >= city.buildings.len() {
                self.push_agent(state, last_actions[agent], UNASSIGNED);
                added(agent);
            }
        }
    }

    /// Writes what each agent sees. No team may be added afterwards.
    ///
    /// Agents after the last closed team have no building and see nothing.
    pub fn finish(&mut self) -> &UtilityInput {
        let UtilityInput { rows, visible } = &mut self.input;
        let agents = rows.len();
        rows.append(&self.others);
        let (mut agent, mut other) = (0, agents);
        for (agent_end, other_end) in &self.ends {
            let members = agent..*agent_end as usize;
            let others = other..agents + *other_end as usize;
            for _ in members.clone() {
                members.clone().chain(others.clone()).for_each(|row| visible.push(row));
                visible.end_list();
            }
            (agent, other) = (members.end, others.end);
        }
        (agent..agents).for_each(|_| visible.end_list());
        &self.input
    }

    /// The input as [`finish`](Self::finish) left it.
    pub fn input(&self) -> &UtilityInput {
        &self.input
    }
}

fn write_agent(rows: &mut SparseRows, agent: &AgentState, last_action: u8) {
    agent_features(agent, |column, value| rows.push(column, value));
    if last_action != NO_ACTION {
        rows.push(FEATURES + usize::from(last_action), 1.0);
    }
}

/// Marks a row with its subtask where there are columns for that.
fn mark(conditioning: Conditioning, rows: &mut SparseRows, task: u8) {
    if conditioning == Conditioning::Input && task != UNASSIGNED {
        rows.push(INPUT_COLUMNS + usize::from(task), 1.0);
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

/// A uniform choice among the available actions, with bits as in [`best_action`].
pub(crate) fn random_action(available: u16, generator: &mut Generator) -> u8 {
    member(generator, available.into()).map_or(0, |action| action as u8)
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
        let agents = [agent(1), agent(2), agent(3), agent(4)];
        let city = City { agents: &agents, buildings: &[building(); 2] };
        let (allocation, last) = ([0, 0, 1, UNASSIGNED], [NO_ACTION, 3, NO_ACTION, NO_ACTION]);
        let mut order = Vec::new();
        batch.push_teams(city, &allocation, &last, |agent| order.push(agent));
        batch.push_unassigned(city, &allocation, &last, |agent| order.push(agent));
        assert_eq!(order, [0, 1, 2, 3]);
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
    fn without_the_mask_everybody_sees_everything() {
        let agents = [1, 2].map(|x| AgentState::at(AgentKind::Builder, x, 2));
        let city = City { agents: &agents, buildings: &[building(); 2] };
        for (conditioning, marks) in [
            (Conditioning::Input, [Some(1), None, Some(0), Some(1)]),
            (Conditioning::None, [None; 4]),
        ] {
            let mut batch = TeamBatch::new(conditioning);
            let mut order = Vec::new();
            batch.push_teams(city, &[1, UNASSIGNED], &[3, 4], |agent| order.push(agent));
            batch.push_unassigned(city, &[1, UNASSIGNED], &[3, 4], |agent| order.push(agent));
            assert_eq!(order, [0, 1]);
            let input = batch.finish();
            for query in 0..2 {
                assert!(input.visible.list(query).eq(0..4));
            }
            let mark = |row| {
                let columns = input.rows.row(row).map(|(column, _)| column);
                columns.filter(|column| *column >= INPUT_COLUMNS).collect::<Vec<_>>()
            };
            for (row, task) in marks.into_iter().enumerate() {
                assert_eq!(mark(row), Vec::from_iter(task.map(|task: usize| INPUT_COLUMNS + task)));
            }
        }
    }

    #[test]
    fn the_best_available_action_is_the_first_of_equals() {
        assert_eq!(best_action(&[1.0, 3.0, 3.0, 9.0], 0b0111), 1);
        assert_eq!(best_action(&[1.0, f32::NAN], 0b10), 1);
    }
}
