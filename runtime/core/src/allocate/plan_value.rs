//! Values of teams by a plan.

use super::team_value::{TeamQuery, TeamValueNetwork};
use crate::allocator::AllocateError;
use crate::entity_mask::EntityMask;
use crate::limits;
use crate::plan::{Network, Plan, PlanError};
use crate::policy::{DecideError, Observation};

/// Teams that are worked on together.
const TOGETHER: usize = 32;

/// Columns between features and relation: flags of the subtask's rows and of the team's.
const FLAGS: usize = 2;

/// A plan as team-value network, over memory that the caller gives.
///
/// The network is an agent's in shape: the subtask's row looks at all others. Its columns are d features,
/// a flag of the subtask's rows, a flag of the team's agents, and F relations. Several teams are decided on like several
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
    fn join(&mut self, scene: &Scene<'_>, row: usize, member: bool) -> Result<(), DecideError> {
        let (query, columns) = (scene.query, self.plan.header().features as usize);
        let (state, stride) = (query.state, query.state.stride);
        let relations = query.relation.len().checked_div(state.entity_task.len()).unwrap_or(0);
        let features = columns.checked_sub(relations + FLAGS).filter(|count| *count <= stride);
        let features = features.ok_or(DecideError::BadLength)?;
        let start = slot(query, row, member).saturating_mul(columns);
        let to = self.rows.get_mut(start..start.saturating_add(columns));
        let [flags_at, relations_at] = [features, features + FLAGS];
        let (to, to_relations) = to
            .and_then(|to| to.split_at_mut_checked(relations_at))
            .ok_or(DecideError::BadLength)?;
        let (to, to_flags) = to.split_at_mut_checked(flags_at).ok_or(DecideError::BadLength)?;
        copy(part(state.rows, row, stride, features)?, to);
        copy(&[flag(query.is_own(row)), flag(member)], to_flags);
        copy(part(query.relation, row, relations, relations)?, to_relations);
        Ok(())
    }

    /// Joins all rows that any of the teams sees.
    fn join_all(&mut self, scene: &Scene<'_>, teams: &[u64]) -> Result<(), DecideError> {
        let anybody = teams.iter().fold(0, |all, team| all | team);
        let everybody = teams.iter().fold(u64::MAX, |all, team| all & team);
        let mut joined = scene.seen;
        joined.insert(scene.own);
        for row in joined.iter() {
            if !scene.is_member(everybody, row) {
                self.join(scene, row, false)?;
            }
            if scene.is_member(anybody, row) {
                self.join(scene, row, true)?;
            }
        }
        Ok(())
    }

    /// Values teams whose rows are joined.
    fn ask(
        &mut self,
        scene: &Scene<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), DecideError> {
        let Self { plan, arena, shared, rows } = self;
        let stride = plan.header().features as usize;
        let mut observations = heapless::Vec::<_, TOGETHER>::new();
        for team in teams {
            // Callers ask about as many as there is room for.
            let _ = observations.push(scene.observation(rows, stride, *team));
        }
        let mut results = [Ok(()); TOGETHER];
        let results = results.get_mut(..observations.len()).ok_or(DecideError::BadLength)?;
        plan.utilities_shared(arena, shared, &observations, values, results);
        results.iter().copied().collect()
    }

    fn ask_all(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), DecideError> {
        let own = query.own_row().ok_or(DecideError::BadLength)?;
        let scene = Scene { query, own, seen: query.visible() };
        self.join_all(&scene, teams)?;
        for (teams, values) in teams.chunks(TOGETHER).zip(values.chunks_mut(TOGETHER)) {
            self.ask(&scene, teams, values)?;
        }
        Ok(())
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
        self.ask_all(query, teams, values).map_err(|error| match error {
            DecideError::TooManyEntities { .. } => AllocateError::TooLarge,
            DecideError::NonFinite => AllocateError::NonFinite,
            _ => AllocateError::BadLength,
        })
    }
}

/// What all teams of a subtask have in common.
struct Scene<'a> {
    query: &'a TeamQuery<'a>,
    /// The subtask's own row.
    own: usize,
    /// The rows that its query attends to.
    seen: EntityMask,
}

impl Scene<'_> {
    fn is_member(&self, team: u64, row: usize) -> bool {
        TeamQuery { team, ..*self.query }.is_member(row)
    }

    /// What a team sees of the joined rows.
    fn observation<'r>(&self, rows: &'r [f32], stride: usize, team: u64) -> Observation<'r> {
        let mut visible = EntityMask::EMPTY;
        for row in self.seen.iter() {
            visible.insert(slot(self.query, row, self.is_member(team, row)));
        }
        Observation {
            rows,
            stride,
            last_actions: &[],
            visible,
            self_index: slot(self.query, self.own, false),
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

/// Copies as much as there is of both.
fn copy(from: &[f32], to: &mut [f32]) {
    for (from, to) in from.iter().zip(to) {
        *to = *from;
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
