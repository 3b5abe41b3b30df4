//! All teams of an allocation in one call.

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::value::Tensor;
use sortie_core::AllocateError;
use sortie_core::allocate::TeamQuery;

use super::{OnnxRuntime, batched_team_values_onnx, refused, run_bound};
use crate::graph::inputs::copy_row;
use crate::graph::{Graph, TeamRoles};
use sortie_plans::CompileError;

/// A team-value network that answers many questions about one state at once, see [`batched_team_values_onnx`].
#[derive(Debug)]
pub struct BatchedTeamValues {
    session: Session,
    roles: TeamRoles,
    bound: Vec<Bound>,
}

/// The tensors of one shape, and the binding that refers to them.
#[derive(Debug)]
struct Bound {
    queries: usize,
    rows: usize,
    binding: IoBinding,
    entities: Tensor<f32>,
    self_index: Tensor<i64>,
    own: Tensor<f32>,
    team: Tensor<f32>,
    relation: Tensor<f32>,
    visible: Tensor<bool>,
}

impl BatchedTeamValues {
    /// Reads the ONNX file of an allocator.
    pub fn new(runtime: &OnnxRuntime, onnx: &[u8]) -> Result<Self, CompileError> {
        let roles = Graph::read(onnx)?.team_roles()?;
        let session = runtime.session(&batched_team_values_onnx(onnx)?)?;
        Ok(Self { session, roles, bound: Vec::new() })
    }

    /// Writes the values `[B]` of queries about the same state.
    pub fn values(
        &mut self,
        queries: &[TeamQuery<'_>],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        let first = queries.first().ok_or(AllocateError::BadLength)?;
        let rows = first.state.entity_task.len();
        let place = self.place(queries.len(), rows).map_err(|_| AllocateError::BadLength)?;
        let Self { session, roles, bound } = self;
        let bound = bound.get_mut(place).ok_or(AllocateError::BadLength)?;
        bound.write(roles, queries)?;
        run_bound(session, &bound.binding, values).ok_or(AllocateError::BadLength)
    }

    /// The place of the tensors of a shape, which are bound at the first use.
    fn place(&mut self, queries: usize, rows: usize) -> Result<usize, CompileError> {
        let fits = |bound: &Bound| bound.queries == queries && bound.rows == rows;
        if let Some(place) = self.bound.iter().position(fits) {
            return Ok(place);
        }
        let bound = Bound::new(&self.session, &self.roles, queries, rows).map_err(refused)?;
        self.bound.push(bound);
        Ok(self.bound.len() - 1)
    }
}

impl Bound {
    fn new(session: &Session, roles: &TeamRoles, queries: usize, rows: usize) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut bound = Self {
            queries,
            rows,
            binding: session.create_binding()?,
            entities: Tensor::new(allocator, [rows, roles.features])?,
            self_index: Tensor::new(allocator, [queries, 2])?,
            own: Tensor::new(allocator, [queries, rows, 1])?,
            team: Tensor::new(allocator, [queries, rows, 1])?,
            relation: Tensor::new(allocator, [queries, rows, roles.relations])?,
            visible: Tensor::new(allocator, [rows])?,
        };
        let Self { binding, entities, self_index, own, team, relation, visible, .. } = &mut bound;
        binding.bind_input("entities", entities)?;
        binding.bind_input("self_index", self_index)?;
        binding.bind_input("own", own)?;
        binding.bind_input("team", team)?;
        binding.bind_input("relation", relation)?;
        binding.bind_input("visible", visible)?;
        binding.bind_output("value", Tensor::<f32>::new(allocator, [queries, 1])?)?;
        Ok(bound)
    }

    fn write(&mut self, roles: &TeamRoles, queries: &[TeamQuery<'_>]) -> Result<(), AllocateError> {
        let first = queries.first().ok_or(AllocateError::BadLength)?;
        let (_, entities) = self.entities.extract_tensor_mut();
        for (row, to) in entities.chunks_exact_mut(roles.features.max(1)).enumerate() {
            copy_row(row, first.state.rows, first.state.stride, to)?;
        }
        let shown = first.visible();
        let (_, visible) = self.visible.extract_tensor_mut();
        visible.iter_mut().enumerate().for_each(|(row, to)| *to = shown.contains(row));
        let floats = self.rows * roles.relations;
        let (_, relation) = self.relation.extract_tensor_mut();
        for (query, to) in queries.iter().zip(relation.chunks_exact_mut(floats.max(1))) {
            to.copy_from_slice(query.relation.get(..floats).ok_or(AllocateError::BadLength)?);
        }
        let (_, own) = self.own.extract_tensor_mut();
        let (_, team) = self.team.extract_tensor_mut();
        let (_, index) = self.self_index.extract_tensor_mut();
        let flags = own.chunks_exact_mut(self.rows).zip(team.chunks_exact_mut(self.rows));
        let places = index.as_chunks_mut::<2>().0.iter_mut();
        for (((number, query), (own, team)), place) in
            queries.iter().enumerate().zip(flags).zip(places)
        {
            let row = query.own_row().ok_or(AllocateError::BadLength)?;
            *place = [number as i64, row as i64];
            own.iter_mut().enumerate().for_each(|(at, to)| *to = f32::from(at == row));
            team.iter_mut().enumerate().for_each(|(at, to)| *to = f32::from(query.is_member(at)));
        }
        Ok(())
    }
}
