//! All agents of a process, or all teams of an allocation, in one call.

use sortie_core::allocate::TeamQuery;
use sortie_core::{AllocateError, DecideError, Observation};
use sortie_plans::{BatchedUtilities, BatchedValues, CompileError};

use super::{AgentColumns, feature_rows};
use crate::engine::{Engine, Tensors, flag};
use crate::graph::{Graph, TeamRoles};
use crate::onnxruntime::{
    OnnxRuntime, SessionEngine, batched_agents_onnx, batched_team_values_onnx,
};

/// An agent's network that answers for all agents of a frame at once, see [`batched_agents_onnx`].
#[derive(Debug)]
pub struct BatchedAgents {
    engine: SessionEngine,
    columns: AgentColumns,
    tensors: Tensors<f32>,
}

impl BatchedAgents {
    /// Reads the ONNX file of one agent; `features` is the number d of columns before the last action's one-hot.
    pub fn new(runtime: &OnnxRuntime, onnx: &[u8], features: usize) -> Result<Self, CompileError> {
        let graph = Graph::read(onnx)?;
        let columns = AgentColumns::new(graph.columns, features, graph.actions)?;
        let engine = SessionEngine::new(runtime, &batched_agents_onnx(onnx)?)?;
        let tensors = Tensors::new(["entities", "self_index", "visible"]);
        Ok(Self { engine, columns, tensors })
    }
}

impl BatchedUtilities for BatchedAgents {
    fn utilities(
        &mut self,
        frame: &[Observation<'_>],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let Self { engine, columns, tensors } = self;
        let first = frame.first().ok_or(DecideError::BadLength)?;
        let (agents, rows) = (frame.len(), first.rows.len() / first.stride.max(1));
        let entities = tensors.room(0, &[rows, columns.columns]).ok_or(DecideError::BadLength)?;
        for row in 0..rows {
            columns.push_row(first, row, entities)?;
        }
        tensors.fill(1, &[agents], frame.iter().map(|seen| seen.self_index as f32));
        let visible = frame.iter().flat_map(|seen| (0..rows).map(move |row| (seen, row)));
        let visible = visible.map(|(seen, row)| flag(seen.visible.contains(row)));
        tensors.fill(2, &[agents, rows], visible);
        let found = engine.run(&tensors.named()).map_err(|_| DecideError::BadLength)?;
        copy(found, utilities).ok_or(DecideError::BadLength)
    }
}

/// A team-value network that answers many questions about one state at once, see [`batched_team_values_onnx`].
#[derive(Debug)]
pub struct BatchedTeamValues {
    engine: SessionEngine,
    roles: TeamRoles,
    tensors: Tensors<f32>,
}

impl BatchedTeamValues {
    /// Reads the ONNX file of an allocator.
    pub fn new(runtime: &OnnxRuntime, onnx: &[u8]) -> Result<Self, CompileError> {
        let roles = Graph::read(onnx)?.team_roles()?;
        let engine = SessionEngine::new(runtime, &batched_team_values_onnx(onnx)?)?;
        let names = ["entities", "visible", "relation", "self_index", "own", "team"];
        Ok(Self { engine, roles, tensors: Tensors::new(names) })
    }
}

impl BatchedValues for BatchedTeamValues {
    fn values(
        &mut self,
        queries: &[TeamQuery<'_>],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        let Self { engine, roles, tensors } = self;
        let TeamRoles { features, relations, .. } = *roles;
        let first = queries.first().ok_or(AllocateError::BadLength)?;
        let (teams, state) = (queries.len(), first.state);
        let (rows, shown) = (state.entity_task.len(), first.visible());
        let entities = feature_rows(0..rows, state.rows, state.stride, features)?;
        tensors.fill(0, &[rows, features], entities);
        tensors.fill(1, &[rows], (0..rows).map(|row| flag(shown.contains(row))));
        let missing = AllocateError::BadLength;
        let relation = tensors.room(2, &[teams, rows, relations]).ok_or(missing)?;
        for query in queries {
            relation.extend(query.relation.get(..rows * relations).ok_or(missing)?);
        }
        let own = queries.iter().map(TeamQuery::own_row).collect::<Option<Vec<usize>>>();
        let own = own.ok_or(missing)?;
        let places = own.iter().enumerate().flat_map(|(number, row)| [number as f32, *row as f32]);
        tensors.fill(3, &[teams, 2], places);
        let is_own =
            queries.iter().flat_map(|query| (0..rows).map(move |row| flag(query.is_own(row))));
        tensors.fill(4, &[teams, rows, 1], is_own);
        let is_member =
            queries.iter().flat_map(|query| (0..rows).map(move |row| flag(query.is_member(row))));
        tensors.fill(5, &[teams, rows, 1], is_member);
        let found = engine.run(&tensors.named()).map_err(|_| missing)?;
        copy(found, values).ok_or(missing)
    }
}

/// The numbers of the last output; none where they are others.
fn copy(found: Vec<Vec<f32>>, to: &mut [f32]) -> Option<()> {
    let found = found.last().filter(|found| found.len() == to.len())?;
    to.copy_from_slice(found);
    Some(())
}
