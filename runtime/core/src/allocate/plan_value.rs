//! Values of teams by a plan.

use super::team_value::{TeamQuery, TeamValueNetwork};
use crate::allocator::AllocateError;
use crate::plan::{Network, Plan, PlanError};
use crate::policy::{DecideError, Observation};

/// Columns between features and relation: own flag and team flag.
const FLAGS: usize = 2;

/// A plan as team-value network, over memory that the caller gives.
///
/// The network is an agent's in shape: the subtask's row looks at all others. Its columns are d features,
/// a flag of the own row, a flag of the team's agents, and F relations.
#[derive(Debug)]
pub struct PlanTeamValue<'a> {
    plan: Plan<'a>,
    arena: &'a mut [u8],
    rows: &'a mut [f32],
}

impl<'a> PlanTeamValue<'a> {
    /// Binds an allocator's plan to its arena, as policies are, and to room for the joined rows of a
    /// state's N entities: `[N, columns]`, see [`Self::row_floats`].
    pub fn new(
        plan: Plan<'a>,
        arena: &'a mut [u8],
        rows: &'a mut [f32],
    ) -> Result<Self, PlanError> {
        plan.check_network(Network::TeamValue)?;
        plan.check_arena(arena)?;
        Ok(Self { plan, arena, rows })
    }

    /// Floats of joined rows that `entities` entities need.
    pub fn row_floats(plan: &Plan<'_>, entities: usize) -> usize {
        entities.saturating_mul(plan.header().features as usize)
    }

    /// Joins the columns of one row.
    fn join(&mut self, query: &TeamQuery<'_>, row: usize, own: usize) -> Result<(), DecideError> {
        let (state, columns) = (query.state, self.plan.header().features as usize);
        let relations = query.relation.len().checked_div(state.entity_task.len()).unwrap_or(0);
        let features = columns.checked_sub(relations + FLAGS).ok_or(DecideError::BadLength)?;
        if features > state.stride {
            return Err(DecideError::BadLength);
        }
        let start = row.saturating_mul(columns);
        let to = self.rows.get_mut(start..start.saturating_add(columns));
        let from = part(state.rows, row, state.stride, features)?.iter();
        let flags = [flag(row == own), flag(query.is_member(row))];
        let from = from.chain(&flags).chain(part(query.relation, row, relations, relations)?);
        for (to, from) in to.ok_or(DecideError::BadLength)?.iter_mut().zip(from) {
            *to = *from;
        }
        Ok(())
    }

    fn ask(&mut self, query: &TeamQuery<'_>) -> Result<f32, DecideError> {
        let own = query.own_row().ok_or(DecideError::BadLength)?;
        let mut joined = query.visible();
        let visible = joined;
        joined.insert(own);
        for row in joined.iter() {
            self.join(query, row, own)?;
        }
        let observation = Observation {
            rows: self.rows,
            stride: self.plan.header().features as usize,
            last_actions: &[],
            visible,
            self_index: own,
            available: &[],
        };
        let mut value = [0.0];
        self.plan.utilities(self.arena, &observation, None, &mut value)?;
        let [value] = value;
        Ok(value)
    }
}

impl TeamValueNetwork for PlanTeamValue<'_> {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        self.ask(query).map_err(|error| match error {
            DecideError::TooManyEntities { .. } => AllocateError::TooLarge,
            DecideError::NonFinite => AllocateError::NonFinite,
            _ => AllocateError::BadLength,
        })
    }
}

fn flag(set: bool) -> f32 {
    if set { 1.0 } else { 0.0 }
}

/// The first `length` floats of a row of `stride`.
fn part(rows: &[f32], row: usize, stride: usize, length: usize) -> Result<&[f32], DecideError> {
    let start = row.saturating_mul(stride);
    rows.get(start..start.saturating_add(length)).ok_or(DecideError::BadLength)
}
