//! The source graph of an allocator, run by tract: the reference for plans, and a back-end for hosts.

use sortie_core::AllocateError;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use tract_onnx::prelude::*;

use crate::engine::{TeamValueEngine, checked_value};
use crate::graph::{Graph, TeamRoles, guarded};
use sortie_plans::CompileError;
use sortie_plans::Rows;

/// A team-value network that runs the ONNX graph with tract, a team at a time. It allocates.
#[derive(Debug)]
pub struct TractTeamValue {
    state: TypedSimpleState,
    roles: TeamRoles,
}

impl TractTeamValue {
    /// Reads an ONNX file. Only the rows that the query attends to, and its own, are given to the graph.
    pub fn new(onnx: &[u8]) -> Result<Self, CompileError> {
        Self::from_graph(&Graph::read(onnx)?)
    }

    pub(crate) fn from_graph(graph: &Graph) -> Result<Self, CompileError> {
        Ok(Self { roles: graph.team_roles()?, state: graph.runnable()? })
    }

    /// Features d of an entity and columns F of its relation.
    pub fn columns(&self) -> (usize, usize) {
        (self.roles.features, self.roles.relations)
    }
}

impl TeamValueEngine for TractTeamValue {
    fn roles(&self) -> TeamRoles {
        self.roles
    }

    fn run(&mut self, query: &TeamQuery<'_>, rows: Rows) -> Result<f32, AllocateError> {
        let roles = self.roles;
        let rows = roles.rows(query, rows)?;
        let count = rows.len();
        let mut features = vec![0.0; count * roles.features];
        let mut relation = vec![0.0; count * roles.relations];
        let mut masks: [Vec<bool>; 5] = std::array::from_fn(|_| vec![false; count]);
        let slices = masks.each_mut().map(Vec::as_mut_slice);
        roles.write(query, &rows, &mut features, &mut relation, slices)?;
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (roles.entities, Tensor::from_shape(&[count, roles.features], &features)?),
                (roles.relation, Tensor::from_shape(&[count, roles.relations], &relation)?),
            ];
            for (slot, mask) in roles.masks().into_iter().zip(&masks) {
                inputs.push((slot, Tensor::from_shape(&[count], mask)?));
            }
            inputs.sort_by_key(|(slot, _)| *slot);
            let outputs = self.state.run(inputs.into_iter().map(|(_, t)| t.into()).collect())?;
            let last = outputs.last().ok_or_else(|| TractError::msg("no output"))?;
            Ok(last.to_plain_array_view::<f32>()?.first().copied().unwrap_or(f32::NAN))
        };
        // What tract may refuse are sizes that the graph cannot take.
        guarded(run).map_err(|_| AllocateError::BadLength)
    }
}

impl TeamValueNetwork for TractTeamValue {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        checked_value(self, query)
    }
}
