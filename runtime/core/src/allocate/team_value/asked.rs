//! What the network is asked about.

use super::{TOGETHER, TaskRelation, TeamQuery, TeamValueNetwork};
use crate::allocate::TeamValue;
use crate::allocator::{AllocateError, AllocationState};

/// Turns teams of present agents into queries of a state's rows; keeps the first error.
pub(super) struct Asked<'a, N, R> {
    network: &'a mut N,
    relation: &'a mut R,
    state: &'a AllocationState<'a>,
    /// Row of every present agent.
    rows: &'a [u8],
    buffer: &'a mut [f32],
    /// The subtask whose relation stands in the buffer.
    related: Option<usize>,
    error: Option<AllocateError>,
}

impl<'a, N: TeamValueNetwork, R: TaskRelation> Asked<'a, N, R> {
    pub(super) fn new(
        network: &'a mut N,
        relation: &'a mut R,
        state: &'a AllocationState<'a>,
        rows: &'a [u8],
        buffer: &'a mut [f32],
    ) -> Result<Self, AllocateError> {
        let floats = state.entity_task.len().saturating_mul(relation.columns());
        let buffer = buffer.get_mut(..floats).ok_or(AllocateError::TooLarge)?;
        Ok(Self { network, relation, state, rows, buffer, related: None, error: None })
    }

    pub(super) fn failed(&self) -> Result<(), AllocateError> {
        self.error.map_or(Ok(()), Err)
    }
}

impl<N: TeamValueNetwork, R: TaskRelation> Asked<'_, N, R> {
    /// The values `[2^A]` of all teams at a subtask. Those of more than `team_max` agents stay as they are: the search
    /// never reads them.
    pub(super) fn all_values(&mut self, task: usize, team_max: usize, values: &mut [f32]) {
        let mut small =
            (0..values.len() as u64).filter(|team| team.count_ones() as usize <= team_max);
        let mut answers = [f32::NAN; TOGETHER];
        loop {
            let mut teams = heapless::Vec::<u64, TOGETHER>::new();
            for team in small.by_ref().take(TOGETHER) {
                // There is room for as many.
                let _ = teams.push(team);
            }
            let Some(answers) = answers.get_mut(..teams.len()) else { return };
            if answers.is_empty() {
                return;
            }
            self.team_values(task, teams.iter().copied(), answers);
            for (team, answer) in teams.iter().zip(answers) {
                if let Some(value) = values.get_mut(*team as usize) {
                    *value = *answer;
                }
            }
        }
    }

    /// The values of up to [`TOGETHER`] teams at a subtask; no numbers from the first error on.
    fn team_values(&mut self, task: usize, teams: impl Iterator<Item = u64>, values: &mut [f32]) {
        if self.error.is_none() {
            if self.related != Some(task) {
                self.relation.write(self.state, task, self.buffer);
                self.related = Some(task);
            }
            let mut rows = heapless::Vec::<u64, TOGETHER>::new();
            for team in teams {
                // Callers ask about as many as there is room for.
                let _ = rows.push(self.team_of_rows(team));
            }
            let query = TeamQuery { state: self.state, task, team: 0, relation: self.buffer };
            self.error = self.network.values(&query, &rows, values).err();
        }
        if self.error.is_some() {
            values.fill(f32::NAN);
        }
    }

    /// A team of present agents as a team of rows.
    fn team_of_rows(&self, team: u64) -> u64 {
        let members = self.rows.iter().enumerate().filter(|(agent, _)| team >> agent & 1 == 1);
        members.fold(0, |team, (_, row)| team | 1_u64 << (*row % 64))
    }
}

impl<N: TeamValueNetwork, R: TaskRelation> TeamValue for Asked<'_, N, R> {
    fn value(&mut self, task: usize, team: u64) -> f32 {
        let mut value = [f32::NAN];
        self.team_values(task, core::iter::once(team), &mut value);
        let [value] = value;
        value
    }
}
