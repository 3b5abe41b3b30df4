//! The source graph of an allocator, run by tract: the reference for plans, and a back-end for hosts.

use sortie_core::AllocateError;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use tract_onnx::prelude::*;

use crate::error::CompileError;
use crate::graph::{Graph, TeamRoles, guarded};

/// A team-value network that runs the ONNX graph with tract, a team at a time. It allocates.
#[derive(Debug)]
pub struct TractTeamValue {
    state: TypedSimpleState,
    roles: TeamRoles,
    compact: bool,
}

impl TractTeamValue {
    /// Reads an ONNX file. Only the rows that the query attends to, and its own, are given to the graph.
    pub fn new(onnx: &[u8]) -> Result<Self, CompileError> {
        Self::from_graph(&Graph::read(onnx)?)
    }

    pub(crate) fn from_graph(graph: &Graph) -> Result<Self, CompileError> {
        Ok(Self { roles: graph.team_roles()?, state: graph.runnable()?, compact: true })
    }

    /// Features d of an entity and columns F of its relation.
    pub fn columns(&self) -> (usize, usize) {
        (self.roles.features, self.roles.relations)
    }

    /// Gives all rows to the graph and leaves masking to it, as a check of the graph needs it.
    pub(crate) fn with_all_rows(mut self) -> Self {
        self.compact = false;
        self
    }

    /// The rows that the graph gets, in order.
    fn rows(&self, query: &TeamQuery<'_>, own: usize) -> Vec<usize> {
        if self.compact {
            let mut rows = query.visible();
            rows.insert(own);
            rows.iter().collect()
        } else {
            (0..query.state.entity_task.len()).collect()
        }
    }

    fn run(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        let own = query.own_row().ok_or(AllocateError::BadLength)?;
        let rows = self.rows(query, own);
        let (state, roles) = (query.state, self.roles);
        let features = select(&rows, state.rows, state.stride, roles.features)?;
        let relation = select(&rows, query.relation, roles.relations, roles.relations)?;
        let mask = |holds: &dyn Fn(usize) -> bool| -> Vec<bool> {
            rows.iter().map(|row| holds(*row)).collect()
        };
        let masks = [
            (roles.present, mask(&|row| state.present.contains(row))),
            (roles.is_agent, mask(&|row| row < state.agents)),
            (roles.in_task, mask(&|row| row == own)),
            (roles.open, mask(&|row| query.is_open(row))),
            (roles.team, mask(&|row| query.is_member(row))),
        ];
        let count = rows.len();
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (roles.entities, Tensor::from_shape(&[count, roles.features], &features)?),
                (roles.relation, Tensor::from_shape(&[count, roles.relations], &relation)?),
            ];
            for (slot, mask) in &masks {
                inputs.push((*slot, Tensor::from_shape(&[count], mask)?));
            }
            inputs.sort_by_key(|(slot, _)| *slot);
            let outputs = self.state.run(inputs.into_iter().map(|(_, t)| t.into()).collect())?;
            let last = outputs.last().ok_or_else(|| TractError::msg("no output"))?;
            Ok(last.to_plain_array_view::<f32>()?.first().copied().unwrap_or(f32::NAN))
        };
        // What tract may refuse are sizes that the graph cannot take.
        let value = guarded(run).map_err(|_| AllocateError::BadLength)?;
        if value.is_finite() { Ok(value) } else { Err(AllocateError::NonFinite) }
    }
}

impl TeamValueNetwork for TractTeamValue {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        self.run(query)
    }
}

/// Some rows of a matrix, as far as `columns`; every number must be finite.
fn select(
    rows: &[usize],
    from: &[f32],
    stride: usize,
    columns: usize,
) -> Result<Vec<f32>, AllocateError> {
    let mut selected: Vec<f32> = Vec::with_capacity(rows.len() * columns);
    for row in rows {
        let values = from.get(row * stride..row * stride + columns);
        selected.extend(values.filter(|_| columns <= stride).ok_or(AllocateError::BadLength)?);
    }
    let finite = selected.iter().all(|value| value.is_finite());
    if finite { Ok(selected) } else { Err(AllocateError::NonFinite) }
}
