//! The team-value allocator: a network values teams, the search finds the best allocation.
//!
//! Only present agents take part. The seam to the network is [`TeamValueNetwork`], what an environment
//! knows beside the features of entities comes from a [`TaskRelation`]; neither is known here.

mod asked;
#[cfg(test)]
mod tests;

use asked::Asked;

use super::{Teams, ascent, exact};
use crate::allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use crate::entity_mask::EntityMask;
use crate::limits;

/// Most agents that are usually searched exactly: beyond, the values of all teams take too long.
pub const EXACT_AGENTS: usize = exact::AGENTS;

/// Teams whose values are asked for in one call.
const TOGETHER: usize = 32;

/// Sweeps of the coordinate ascent; few are needed until no agent moves.
const SWEEPS: usize = 8;

/// A team at a subtask of a state: what the network is asked about.
#[derive(Clone, Copy, Debug)]
pub struct TeamQuery<'a> {
    /// Entities, subtasks and agents.
    pub state: &'a AllocationState<'a>,
    /// The subtask, which is open.
    pub task: usize,
    /// Bit a set where the agent in row a is in the team.
    pub team: u64,
    /// How each entity relates to the subtask, `[N, F]`.
    pub relation: &'a [f32],
}

impl TeamQuery<'_> {
    /// The subtask's own row, which forms the query: the first that is present, or the first of all where none is; none
    /// where no row belongs to it.
    pub fn own_row(&self) -> Option<usize> {
        let mut rows =
            (self.state.agents..self.state.entity_task.len()).filter(|row| self.is_of_task(*row));
        let first = rows.clone().next();
        rows.find(|row| self.state.present.contains(*row)).or(first)
    }

    /// Whether a row is marked as the subtask's: the own row, and whatever else of it is present.
    pub fn is_own(&self, row: usize) -> bool {
        let is_shown = || self.state.present.contains(row) || self.own_row() == Some(row);
        self.is_of_task(row) && is_shown()
    }

    /// Whether a row is a thing of the subtask, be it present or not.
    fn is_of_task(&self, row: usize) -> bool {
        let tasks = self.state.entity_task.get(row).copied().unwrap_or(0);
        row >= self.state.agents && tasks.checked_shr(self.task as u32).unwrap_or(0) & 1 == 1
    }

    /// Whether a row stands for something of an open subtask.
    pub fn is_open(&self, row: usize) -> bool {
        let tasks = self.state.entity_task.get(row).copied().unwrap_or(0);
        row >= self.state.agents && tasks & self.state.open_tasks != 0
    }

    /// Whether a row is an agent of the team.
    pub fn is_member(&self, row: usize) -> bool {
        row < self.state.agents && self.team.checked_shr(row as u32).unwrap_or(0) & 1 == 1
    }

    /// The rows that the query attends to: present agents, and what is present of open subtasks.
    pub fn visible(&self) -> EntityMask {
        let mut visible = EntityMask::EMPTY;
        for row in self.state.present.iter() {
            if row < self.state.agents || self.is_open(row) {
                visible.insert(row);
            }
        }
        visible
    }
}

/// What a team at a subtask is worth, by a network.
pub trait TeamValueNetwork {
    /// The value; one that is no number counts as the lowest.
    ///
    /// # Errors
    /// The query does not fit the network, or a visible feature is not a finite number.
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError>;

    /// Writes the values of several teams in the place of the query's; networks may share work among them.
    ///
    /// # Errors
    /// As [`Self::value`] of the first team that has one; values are then incomplete.
    fn values(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        for (team, value) in teams.iter().zip(values) {
            *value = self.value(&TeamQuery { team: *team, ..*query })?;
        }
        Ok(())
    }
}

impl<V: TeamValueNetwork + ?Sized> TeamValueNetwork for &mut V {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        (**self).value(query)
    }

    fn values(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        (**self).values(query, teams, values)
    }
}

/// What is known of an entity and a subtask beside the entity's features, for example a travel time.
pub trait TaskRelation {
    /// Columns F.
    fn columns(&self) -> usize;

    /// Looks at a state; what is written next is about it.
    ///
    /// # Errors
    /// The state is none of the environment's.
    fn observe(&mut self, state: &AllocationState<'_>) -> Result<(), AllocateError>;

    /// Writes the relation `[N, F]` of every entity to a subtask.
    fn write(&mut self, state: &AllocationState<'_>, task: usize, relation: &mut [f32]);
}

/// Features say it all: F = 0.
impl TaskRelation for () {
    fn columns(&self) -> usize {
        0
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, _: usize, _: &mut [f32]) {}
}

/// Starts from the last allocation, as the state has it.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastAllocation;

impl Allocator for LastAllocation {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        if allocation.len() > state.entity_task.len() {
            return Err(AllocateError::BadLength);
        }
        for (place, tasks) in allocation.iter_mut().zip(state.entity_task) {
            let task = tasks & state.open_tasks;
            *place = if task == 0 { UNASSIGNED } else { task.trailing_zeros() as u8 };
        }
        Ok(())
    }
}

/// Working memory of a [`TeamValueAllocator`].
#[derive(Debug)]
pub struct SearchMemory<'a> {
    /// Table of the exact search: [`exact::cells`] of its agents and subtasks.
    pub cells: &'a mut [exact::Cell],
    /// Values of all teams, as many as cells.
    pub values: &'a mut [f32],
    /// The relation to one subtask, `[N, F]`.
    pub relation: &'a mut [f32],
}

/// Allocates by the values of a network.
///
/// The best of all allocations for up to `exact_agents` present agents, as far as the memory holds them;
/// beyond, coordinate ascent from what `start` allocates. Absent agents are [`UNASSIGNED`] and in no team.
#[derive(Debug)]
pub struct TeamValueAllocator<'a, N, R, S> {
    /// Values teams.
    pub network: N,
    /// What the network knows beside features.
    pub relation: R,
    /// Gives the start of the ascent.
    pub start: S,
    /// Largest team of one subtask.
    pub team_max: usize,
    /// Most agents that are searched exactly, usually [`EXACT_AGENTS`]; never more than [`exact::AGENTS`].
    pub exact_agents: usize,
    /// Working memory.
    pub memory: SearchMemory<'a>,
}

impl<N, R, S> Allocator for TeamValueAllocator<'_, N, R, S>
where
    N: TeamValueNetwork,
    R: TaskRelation,
    S: Allocator,
{
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        self.relation.observe(state)?;
        let present = (0..state.agents).filter(|row| state.present.contains(*row));
        let mut rows = heapless::Vec::<u8, { limits::AGENTS }>::new();
        for row in present {
            rows.push(row as u8).map_err(|_| AllocateError::TooLarge)?;
        }
        let teams =
            Teams { agents: rows.len(), open_tasks: state.open_tasks, team_max: self.team_max };
        let mut places = [UNASSIGNED; limits::AGENTS];
        let places = places.get_mut(..rows.len()).ok_or(AllocateError::TooLarge)?;
        let cells = exact::cells(teams.agents, teams.open_tasks.count_ones() as usize);
        if teams.agents <= self.exact_agents && cells <= self.memory.cells.len() {
            self.search_all(state, &rows, teams, places)?;
        } else {
            self.start.allocate(state, allocation)?;
            for (place, row) in places.iter_mut().zip(&rows) {
                *place = allocation.get(usize::from(*row)).copied().unwrap_or(UNASSIGNED);
            }
            self.climb(state, &rows, teams, places)?;
        }
        allocation.fill(UNASSIGNED);
        for (place, row) in places.iter().zip(&rows) {
            if let Some(to) = allocation.get_mut(usize::from(*row)) {
                *to = *place;
            }
        }
        Ok(())
    }
}

impl<N, R, S> TeamValueAllocator<'_, N, R, S>
where
    N: TeamValueNetwork,
    R: TaskRelation,
{
    fn search_all(
        &mut self,
        state: &AllocationState<'_>,
        rows: &[u8],
        teams: Teams,
        places: &mut [u8],
    ) -> Result<(), AllocateError> {
        let Self { network, relation, memory, .. } = self;
        let SearchMemory { cells, values, relation: buffer } = memory;
        let open = teams.open_tasks.count_ones() as usize;
        let values = values.get_mut(..exact::cells(teams.agents, open));
        let values = values.ok_or(AllocateError::TooLarge)?;
        let mut asked = Asked::new(network, relation, state, rows, buffer)?;
        for (task, values) in teams.tasks().zip(values.chunks_exact_mut(1 << teams.agents)) {
            asked.all_values(task, teams.team_max, values);
        }
        asked.failed()?;
        exact::search(teams, values, cells, places).map(drop)
    }

    fn climb(
        &mut self,
        state: &AllocationState<'_>,
        rows: &[u8],
        teams: Teams,
        places: &mut [u8],
    ) -> Result<(), AllocateError> {
        let Self { network, relation, memory, .. } = self;
        let mut asked = Asked::new(network, relation, state, rows, memory.relation)?;
        ascent::search(teams, &mut asked, SWEEPS, places)?;
        asked.failed()
    }
}
