//! What the graph of a network gets of an observation or of a team query, whichever engine runs it; and the engines that
//! plans are compared with.

use sortie_core::allocate::TeamQuery;
use sortie_core::{AllocateError, DecideError, EntityMask, NO_ACTION, Observation};
use sortie_plans::{CompileError, Rows};

use crate::graph::TeamRoles;

/// Columns of an agent's graph.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AgentColumns {
    /// Columns D of a row.
    pub(crate) columns: usize,
    /// Features d before the last action's one-hot.
    pub(crate) features: usize,
}

impl AgentColumns {
    /// Checks that rows are features, with or without the one-hot of `actions` behind them.
    pub(crate) fn new(
        columns: usize,
        features: usize,
        actions: usize,
    ) -> Result<Self, CompileError> {
        if columns != features && columns != features + actions {
            let what = "the input width".into();
            return Err(CompileError::Size { what, got: columns, want: features + actions });
        }
        Ok(Self { columns, features })
    }

    /// The rows that a graph gets, in rising order; the own one is always among them.
    pub(crate) fn rows(
        self,
        observation: &Observation<'_>,
        rows: Rows,
    ) -> Result<EntityMask, DecideError> {
        let count = observation.rows.len() / observation.stride.max(1);
        let mut mask = match rows {
            Rows::All => EntityMask::first(count),
            Rows::Visible => observation.visible,
        };
        mask.insert(observation.self_index);
        let exist = mask.and(&EntityMask::first(count)) == mask;
        let fits = exist && mask.contains(observation.self_index);
        if fits { Ok(mask) } else { Err(DecideError::BadLength) }
    }

    /// Writes `entities` `[n, D]` and the mask `[n]` of the given rows, and returns the own row's place.
    pub(crate) fn write(
        self,
        observation: &Observation<'_>,
        rows: &EntityMask,
        entities: &mut [f32],
        visible: &mut [bool],
    ) -> Result<i64, DecideError> {
        let mut own = 0;
        let places = entities.chunks_exact_mut(self.columns.max(1)).zip(visible);
        for ((place, row), (to, visible)) in rows.iter().enumerate().zip(places) {
            self.write_row(observation, row, to)?;
            *visible = observation.visible.contains(row);
            if row == observation.self_index {
                own = place as i64;
            }
        }
        Ok(own)
    }

    /// Writes the columns `[D]` of one row.
    pub(crate) fn write_row(
        self,
        observation: &Observation<'_>,
        row: usize,
        to: &mut [f32],
    ) -> Result<(), DecideError> {
        let start = row * observation.stride;
        let from = observation.rows.get(start..start + self.features);
        let (features, one_hot) = to.split_at_mut(self.features);
        features.copy_from_slice(from.ok_or(DecideError::BadLength)?);
        one_hot.fill(0.0);
        match observation.last_actions.get(row) {
            Some(&action) if !one_hot.is_empty() && action != NO_ACTION => {
                let slot = one_hot.get_mut(usize::from(action)).ok_or(DecideError::BadLength)?;
                *slot = 1.0;
            }
            _ => {}
        }
        Ok(())
    }

    /// Refuses what plans refuse: a feature of these rows that is not a finite number.
    pub(crate) fn check_finite(
        self,
        observation: &Observation<'_>,
        rows: &EntityMask,
    ) -> Result<(), DecideError> {
        for row in rows.iter() {
            let start = row * observation.stride;
            let features = observation.rows.get(start..start + self.features);
            if !all_finite(features.ok_or(DecideError::BadLength)?) {
                return Err(DecideError::NonFinite);
            }
        }
        Ok(())
    }
}

/// Whether every value is a finite number.
pub(crate) fn all_finite(values: &[f32]) -> bool {
    values.iter().all(|value| value.is_finite())
}

/// The masks of a team-value graph, in the order of [`TeamRoles::masks`].
type TeamMasks<'a> = [&'a mut [bool]; 5];

impl TeamRoles {
    /// The inputs that are masks: present, is_agent, in_task, open, team.
    pub(crate) fn masks(&self) -> [usize; 5] {
        [self.present, self.is_agent, self.in_task, self.open, self.team]
    }

    /// The rows that the graph gets, in rising order; the own one is always among them.
    pub(crate) fn rows(
        &self,
        query: &TeamQuery<'_>,
        rows: Rows,
    ) -> Result<EntityMask, AllocateError> {
        let own = query.own_row().ok_or(AllocateError::BadLength)?;
        let mut mask = match rows {
            Rows::All => EntityMask::first(query.state.entity_task.len()),
            Rows::Visible => query.visible(),
        };
        mask.insert(own);
        Ok(mask)
    }

    /// Writes `entities` `[n, d]`, `relation` `[n, F]` and the masks `[n]` of the given rows.
    pub(crate) fn write(
        &self,
        query: &TeamQuery<'_>,
        rows: &EntityMask,
        entities: &mut [f32],
        relation: &mut [f32],
        masks: TeamMasks<'_>,
    ) -> Result<(), AllocateError> {
        let (state, own) = (query.state, query.own_row());
        copy_rows(rows, state.rows, state.stride, self.features, entities)?;
        copy_rows(rows, query.relation, self.relations, self.relations, relation)?;
        let holds: [&dyn Fn(usize) -> bool; 5] = [
            &|row| state.present.contains(row),
            &|row| row < state.agents,
            &|row| Some(row) == own,
            &|row| query.is_open(row),
            &|row| query.is_member(row),
        ];
        for (mask, holds) in masks.into_iter().zip(holds) {
            for (to, row) in mask.iter_mut().zip(rows.iter()) {
                *to = holds(row);
            }
        }
        Ok(())
    }

    /// Refuses what plans refuse: a number of these rows that is not finite.
    pub(crate) fn check_finite(
        &self,
        query: &TeamQuery<'_>,
        rows: &EntityMask,
    ) -> Result<(), AllocateError> {
        let matrices = [
            (query.state.rows, query.state.stride, self.features),
            (query.relation, self.relations, self.relations),
        ];
        for (values, stride, columns) in matrices {
            for row in rows.iter() {
                let values = values.get(row * stride..row * stride + columns);
                if !all_finite(values.ok_or(AllocateError::BadLength)?) {
                    return Err(AllocateError::NonFinite);
                }
            }
        }
        Ok(())
    }
}

/// Copies some rows of a matrix, as far as `columns`.
fn copy_rows(
    rows: &EntityMask,
    from: &[f32],
    stride: usize,
    columns: usize,
    to: &mut [f32],
) -> Result<(), AllocateError> {
    for (row, to) in rows.iter().zip(to.chunks_exact_mut(columns.max(1))) {
        copy_row(row, from, stride, to)?;
    }
    Ok(())
}

/// Copies one row of a matrix, as far as `to` is long.
pub(crate) fn copy_row(
    row: usize,
    from: &[f32],
    stride: usize,
    to: &mut [f32],
) -> Result<(), AllocateError> {
    let start = row * stride;
    let from = from.get(start..start + to.len()).filter(|_| to.len() <= stride);
    to.copy_from_slice(from.ok_or(AllocateError::BadLength)?);
    Ok(())
}

/// An engine with an agent's graph.
pub(crate) trait AgentEngine {
    /// The columns of the graph's rows.
    fn columns(&self) -> AgentColumns;

    /// Writes what the graph gives `[U]`, an agent with memory with an empty one, whatever numbers these are: nothing is
    /// refused for its values.
    fn run(
        &mut self,
        observation: &Observation<'_>,
        rows: Rows,
        utilities: &mut [f32],
    ) -> Result<(), DecideError>;
}

/// An engine with the team-value graph of an allocator.
pub(crate) trait TeamValueEngine {
    /// The inputs of the graph.
    fn roles(&self) -> TeamRoles;

    /// What the graph gives, whatever number this is.
    fn run(&mut self, query: &TeamQuery<'_>, rows: Rows) -> Result<f32, AllocateError>;
}

/// The utilities by the rules of [`sortie_core::Policy`]: what is not a finite number is refused.
pub(crate) fn checked_utilities(
    engine: &mut dyn AgentEngine,
    observation: &Observation<'_>,
    utilities: &mut [f32],
) -> Result<(), DecideError> {
    let columns = engine.columns();
    columns.check_finite(observation, &columns.rows(observation, Rows::Visible)?)?;
    engine.run(observation, Rows::Visible, utilities)?;
    if all_finite(utilities) { Ok(()) } else { Err(DecideError::NonFinite) }
}

/// The value by the rules of [`sortie_core::allocate::TeamValueNetwork`]: what is not a finite number is refused.
pub(crate) fn checked_value(
    engine: &mut dyn TeamValueEngine,
    query: &TeamQuery<'_>,
) -> Result<f32, AllocateError> {
    let roles = engine.roles();
    roles.check_finite(query, &roles.rows(query, Rows::Visible)?)?;
    let value = engine.run(query, Rows::Visible)?;
    if value.is_finite() { Ok(value) } else { Err(AllocateError::NonFinite) }
}
