//! All agents of a process, or all teams of an allocation, in one call.

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::value::Tensor;
use sortie_core::allocate::TeamQuery;
use sortie_core::{AllocateError, DecideError, EntityMask, Observation};
use sortie_plans::CompileError;

use super::{OnnxRuntime, batched_agents_onnx, batched_team_values_onnx, run_bound};
use crate::graph::inputs::{AgentColumns, copy_row};
use crate::graph::{Graph, TeamRoles};

/// An agent's network that answers for all agents of a frame at once, see [`batched_agents_onnx`].
#[derive(Debug)]
pub struct BatchedAgents {
    session: Session,
    columns: AgentColumns,
    actions: usize,
    bound: Shapes<Bound>,
}

/// What is bound at the first use of a shape: so many questions about so many rows.
#[derive(Debug)]
struct Shapes<T>(Vec<([usize; 2], T)>);

impl<T> Shapes<T> {
    fn of(
        &mut self,
        shape: [usize; 2],
        bind: impl FnOnce() -> ort::Result<T>,
    ) -> ort::Result<&mut T> {
        let known = self.0.iter().position(|(known, _)| *known == shape);
        let place = known.unwrap_or(self.0.len());
        if known.is_none() {
            self.0.push((shape, bind()?));
        }
        Ok(&mut self.0[place].1)
    }
}

/// The tensors of one shape, and the binding that refers to them.
#[derive(Debug)]
struct Bound {
    rows: usize,
    binding: IoBinding,
    entities: Tensor<f32>,
    self_index: Tensor<i64>,
    visible: Tensor<bool>,
}

impl BatchedAgents {
    /// Reads the ONNX file of one agent; `features` is the number d of columns before the last action's one-hot.
    pub fn new(runtime: &OnnxRuntime, onnx: &[u8], features: usize) -> Result<Self, CompileError> {
        let graph = Graph::read(onnx)?;
        let (columns, actions) = (graph.columns, graph.actions);
        let columns = AgentColumns::new(columns, features, actions)?;
        let session = runtime.session(&batched_agents_onnx(onnx)?)?;
        Ok(Self { session, columns, actions, bound: Shapes(Vec::new()) })
    }

    /// Writes the utilities `[B, U]` of the agents of one frame: their observations have the same rows.
    pub fn utilities(
        &mut self,
        frame: &[Observation<'_>],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let first = frame.first().ok_or(DecideError::BadLength)?;
        let rows = first.rows.len() / first.stride.max(1);
        let Self { session, columns, actions, bound } = self;
        let (agents, sizes) = (frame.len(), [columns.columns, *actions]);
        let bound = bound.of([agents, rows], || Bound::new(session, [agents, rows], sizes));
        let bound = bound.map_err(|_| DecideError::BadLength)?;
        bound.write(*columns, frame)?;
        run_bound(session, &bound.binding, utilities).ok_or(DecideError::BadLength)
    }
}

impl Bound {
    fn new(
        session: &Session,
        [agents, rows]: [usize; 2],
        [columns, actions]: [usize; 2],
    ) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut bound = Self {
            rows,
            binding: session.create_binding()?,
            entities: Tensor::new(allocator, [rows, columns])?,
            self_index: Tensor::new(allocator, [agents])?,
            visible: Tensor::new(allocator, [agents, rows])?,
        };
        bound.binding.bind_input("entities", &bound.entities)?;
        bound.binding.bind_input("self_index", &bound.self_index)?;
        bound.binding.bind_input("visible", &bound.visible)?;
        let utilities = Tensor::<f32>::new(allocator, [agents, actions])?;
        bound.binding.bind_output("utilities", utilities)?;
        Ok(bound)
    }

    fn write(
        &mut self,
        columns: AgentColumns,
        frame: &[Observation<'_>],
    ) -> Result<(), DecideError> {
        let (_, entities) = self.entities.extract_tensor_mut();
        let (_, visible) = self.visible.extract_tensor_mut();
        let (_, own) = self.self_index.extract_tensor_mut();
        let all = EntityMask::first(self.rows);
        let masks = visible.chunks_exact_mut(self.rows.max(1));
        for ((observation, mask), own) in frame.iter().zip(masks).zip(own) {
            for (row, visible) in mask.iter_mut().enumerate() {
                *visible = observation.visible.contains(row);
            }
            *own = observation.self_index as i64;
        }
        let first = frame.first().ok_or(DecideError::BadLength)?;
        for (row, to) in all.iter().zip(entities.chunks_exact_mut(columns.columns.max(1))) {
            columns.write_row(first, row, to)?;
        }
        Ok(())
    }
}

/// A team-value network that answers many questions about one state at once, see [`batched_team_values_onnx`].
#[derive(Debug)]
pub struct BatchedTeamValues {
    session: Session,
    roles: TeamRoles,
    bound: Shapes<TeamBound>,
}

/// The tensors of one shape, and the binding that refers to them.
#[derive(Debug)]
struct TeamBound {
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
        Ok(Self { session, roles, bound: Shapes(Vec::new()) })
    }

    /// Writes the values `[B]` of queries about the same state.
    pub fn values(
        &mut self,
        queries: &[TeamQuery<'_>],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        let first = queries.first().ok_or(AllocateError::BadLength)?;
        let rows = first.state.entity_task.len();
        let Self { session, roles, bound } = self;
        let shape = [queries.len(), rows];
        let bound = bound.of(shape, || TeamBound::new(session, roles, shape));
        let bound = bound.map_err(|_| AllocateError::BadLength)?;
        bound.write(roles, queries)?;
        run_bound(session, &bound.binding, values).ok_or(AllocateError::BadLength)
    }
}

impl TeamBound {
    fn new(session: &Session, roles: &TeamRoles, [queries, rows]: [usize; 2]) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut bound = Self {
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
