//! Engines that run the ONNX graph itself: what plans are compared with.

use sortie_core::allocate::TeamQuery;
use sortie_core::{AllocateError, DecideError, Observation};

use crate::graph::TeamRoles;
use crate::graph::inputs::{AgentColumns, all_finite};
use sortie_plans::Rows;

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
