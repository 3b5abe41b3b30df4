//! Values of teams by a plan.

use super::team_value::{TeamQuery, TeamValueNetwork};
use crate::allocator::AllocateError;
use crate::entity_mask::EntityMask;
use crate::limits;
use crate::plan::{Network, Plan, PlanError};
use crate::policy::{DecideError, Observation};

/// Teams that are worked on together.
const TOGETHER: usize = 16;

/// Columns between features and relation: own flag and team flag.
const FLAGS: usize = 2;

/// A plan as team-value network, over memory that the caller gives.
///
/// The network is an agent's in shape: the subtask's row looks at all others. Its columns are d features,
/// a flag of the own row, a flag of the team's agents, and F relations. Several teams are decided on like several
/// agents of one frame: its rows are every agent once as a stranger and once as a member, then all others, and
/// a team sees of each agent the row that fits. So rows are embedded once, and matrices read once, for all teams;
/// and as all of them ask the subtask's own query, scores and values of rows are computed once as well.
#[derive(Debug)]
pub struct PlanTeamValue<'a> {
    plan: Plan<'a>,
    arena: &'a mut [u8],
    /// What all teams have in common.
    shared: &'a mut [f32],
    rows: &'a mut [f32],
}

impl<'a> PlanTeamValue<'a> {
    /// Binds an allocator's plan to its arena, as policies are (with [`Plan::batch_arena_bytes`] several teams are
    /// worked on together), and to memory for states of N entities, see [`Self::memory_floats`].
    ///
    /// # Errors
    /// The plan is another network's, or the arena or the memory is too small.
    pub fn new(
        plan: Plan<'a>,
        arena: &'a mut [u8],
        memory: &'a mut [f32],
    ) -> Result<Self, PlanError> {
        plan.check_network(Network::TeamValue)?;
        plan.check_arena(arena)?;
        let (need, got) = (plan.shared_floats(), memory.len());
        let (shared, rows) = memory
            .split_at_mut_checked(need)
            .ok_or(PlanError::ArenaTooSmall { need: 4 * need, got: 4 * got })?;
        Ok(Self { plan, arena, shared, rows })
    }

    /// Floats of memory for states of `entities` entities: what teams share, and joined rows, of which every
    /// entity may be an agent and have two.
    pub fn memory_floats(plan: &Plan<'_>, entities: usize) -> usize {
        let rows = entities.saturating_mul(2 * plan.header().features as usize);
        plan.shared_floats().saturating_add(rows)
    }

    /// Joins the columns of an entity in the row of its slot.
    fn join(&mut self, query: &TeamQuery<'_>, row: usize, member: bool) -> Result<(), DecideError> {
        let (state, columns) = (query.state, self.plan.header().features as usize);
        let relations = query.relation.len().checked_div(state.entity_task.len()).unwrap_or(0);
        let features = columns.checked_sub(relations + FLAGS).ok_or(DecideError::BadLength)?;
        if features > state.stride {
            return Err(DecideError::BadLength);
        }
        let start = slot(query, row, member).saturating_mul(columns);
        let to = self.rows.get_mut(start..start.saturating_add(columns));
        let from = part(state.rows, row, state.stride, features)?.iter();
        let flags = [flag(query.own_row() == Some(row)), flag(member)];
        let from = from.chain(&flags).chain(part(query.relation, row, relations, relations)?);
        for (to, from) in to.ok_or(DecideError::BadLength)?.iter_mut().zip(from) {
            *to = *from;
        }
        Ok(())
    }

    /// Joins all rows that any of the teams sees.
    fn join_all(
        &mut self,
        query: &TeamQuery<'_>,
        own: usize,
        teams: &[u64],
    ) -> Result<(), DecideError> {
        let anybody = teams.iter().fold(0, |all, team| all | team);
        let everybody = teams.iter().fold(u64::MAX, |all, team| all & team);
        let mut joined = query.visible();
        joined.insert(own);
        for row in joined.iter() {
            if !(TeamQuery { team: everybody, ..*query }).is_member(row) {
                self.join(query, row, false)?;
            }
            if (TeamQuery { team: anybody, ..*query }).is_member(row) {
                self.join(query, row, true)?;
            }
        }
        Ok(())
    }

    fn ask(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), DecideError> {
        let own = query.own_row().ok_or(DecideError::BadLength)?;
        self.join_all(query, own, teams)?;
        let stride = self.plan.header().features as usize;
        let frame = Frame { rows: self.rows, stride, own: slot(query, own, false) };
        let team = |team: &u64| frame.observation(&TeamQuery { team: *team, ..*query });
        let mut observations = heapless::Vec::<_, TOGETHER>::new();
        for observation in teams.iter().map(team) {
            // Callers ask about as many as there is room for.
            let _ = observations.push(observation);
        }
        let mut results = [Ok(()); TOGETHER];
        let results = results.get_mut(..observations.len()).ok_or(DecideError::BadLength)?;
        let Self { plan, arena, shared, .. } = self;
        plan.utilities_shared(arena, shared, &observations, values, results);
        results.iter().copied().collect()
    }
}

impl TeamValueNetwork for PlanTeamValue<'_> {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        let mut value = [0.0];
        self.values(query, &[query.team], &mut value)?;
        let [value] = value;
        Ok(value)
    }

    fn values(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        if slot(query, query.state.entity_task.len(), false) > limits::ENTITIES {
            return Err(AllocateError::TooLarge);
        }
        for (teams, values) in teams.chunks(TOGETHER).zip(values.chunks_mut(TOGETHER)) {
            self.ask(query, teams, values).map_err(|error| match error {
                DecideError::TooManyEntities { .. } => AllocateError::TooLarge,
                DecideError::NonFinite => AllocateError::NonFinite,
                _ => AllocateError::BadLength,
            })?;
        }
        Ok(())
    }
}

/// The joined rows of one subtask.
struct Frame<'a> {
    rows: &'a [f32],
    stride: usize,
    /// The subtask's own slot.
    own: usize,
}

impl<'a> Frame<'a> {
    /// What a team sees.
    fn observation(&self, query: &TeamQuery<'_>) -> Observation<'a> {
        let mut visible = EntityMask::EMPTY;
        for row in query.visible().iter() {
            visible.insert(slot(query, row, query.is_member(row)));
        }
        Observation {
            rows: self.rows,
            stride: self.stride,
            last_actions: &[],
            visible,
            self_index: self.own,
            available: &[],
        }
    }
}

/// Where an entity's joined row stands: agents have two in turn, a stranger's and a member's, others follow.
/// Rising with the entity, so that sums over rows keep their order.
fn slot(query: &TeamQuery<'_>, row: usize, member: bool) -> usize {
    let agents = query.state.agents;
    if row < agents { 2 * row + usize::from(member) } else { agents.saturating_add(row) }
}

fn flag(set: bool) -> f32 {
    if set { 1.0 } else { 0.0 }
}

/// The first `length` floats of a row of `stride`.
fn part(rows: &[f32], row: usize, stride: usize, length: usize) -> Result<&[f32], DecideError> {
    let start = row.saturating_mul(stride);
    rows.get(start..start.saturating_add(length)).ok_or(DecideError::BadLength)
}
