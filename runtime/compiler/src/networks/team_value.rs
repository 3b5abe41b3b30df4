//! The graph of an allocator that values teams: rows of entities, how each relates to the subtask, and five masks.

use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::{AllocateError, EntityMask};
use sortie_plans::{CompileError, Rows};

use super::{Opens, Tract};
use crate::engine::{AnyEngine, Engine, Tensors, flag};
use crate::graph::{Graph, TeamRoles};
use crate::onnxruntime::OnnxRuntime;

/// A team-value graph in an engine.
#[derive(Debug)]
pub(crate) struct TeamGraph<E: Engine> {
    pub(super) engine: E,
    roles: TeamRoles,
    /// Entities, relation, present, is_agent, in_task, open, team.
    tensors: Tensors<E::Number>,
}

impl<E: Engine> TeamGraph<E> {
    pub(crate) fn new(graph: &Graph, engine: E) -> Result<Self, CompileError> {
        let roles = graph.team_roles()?;
        let TeamRoles { entities, relation, present, is_agent, in_task, open, team, .. } = roles;
        let inputs = [entities, relation, present, is_agent, in_task, open, team];
        let tensors = Tensors::new(inputs.map(|input| graph.input_name(input)));
        Ok(Self { engine, roles, tensors })
    }

    /// What the graph gives, whatever number this is.
    pub(crate) fn run(
        &mut self,
        query: &TeamQuery<'_>,
        rows: Rows,
    ) -> Result<E::Number, AllocateError> {
        let Self { engine, roles, tensors } = self;
        let state = query.state;
        let rows = rows_of(query, rows)?;
        let count = rows.len();
        let matrices = [
            (state.rows, state.stride, roles.features),
            (query.relation, roles.relations, roles.relations),
        ];
        for (place, (matrix, stride, columns)) in matrices.into_iter().enumerate() {
            let found = feature_rows(rows.iter(), matrix, stride, columns)?;
            tensors.fill(place, &[count, columns], found);
        }
        let masks: [&dyn Fn(usize) -> bool; 5] = [
            &|row| state.present.contains(row),
            &|row| row < state.agents,
            &|row| query.is_own(row),
            &|row| query.is_open(row),
            &|row| query.is_member(row),
        ];
        for (place, holds) in masks.into_iter().enumerate() {
            tensors.fill(2 + place, &[count], rows.iter().map(|row| flag(holds(row))));
        }
        // What engines may refuse are sizes that the graph cannot take.
        let outputs = engine.run(&tensors.named()).map_err(|_| AllocateError::BadLength)?;
        outputs.last().and_then(|value| value.first()).copied().ok_or(AllocateError::BadLength)
    }

    /// Refuses what plans refuse: a number of these rows that is not finite.
    fn check_finite(&self, query: &TeamQuery<'_>) -> Result<(), AllocateError> {
        let TeamRoles { features, relations, .. } = self.roles;
        let rows = rows_of(query, Rows::Visible)?;
        let state = query.state;
        let features = feature_rows(rows.iter(), state.rows, state.stride, features)?;
        let relation = feature_rows(rows.iter(), query.relation, relations, relations)?;
        let is_finite = features.chain(relation).all(f32::is_finite);
        if is_finite { Ok(()) } else { Err(AllocateError::NonFinite) }
    }
}

/// The rows that the graph gets, in rising order; the own one is always among them.
fn rows_of(query: &TeamQuery<'_>, rows: Rows) -> Result<EntityMask, AllocateError> {
    let own = query.own_row().ok_or(AllocateError::BadLength)?;
    let mut mask = match rows {
        Rows::All => EntityMask::first(query.state.entity_task.len()),
        Rows::Visible => query.visible(),
    };
    mask.insert(own);
    Ok(mask)
}

/// Some rows of a matrix, as far as `columns`, one behind the other.
pub(crate) fn feature_rows(
    rows: impl Iterator<Item = usize>,
    matrix: &[f32],
    stride: usize,
    columns: usize,
) -> Result<impl Iterator<Item = f32>, AllocateError> {
    let row = |row: usize| matrix.get(row * stride..row * stride + columns);
    let found: Option<Vec<&[f32]>> = rows.map(row).collect();
    let found = found.filter(|_| columns <= stride).ok_or(AllocateError::BadLength)?;
    Ok(found.into_iter().flatten().copied())
}

/// A team-value network that runs its ONNX graph, a team at a time. It allocates.
#[derive(Debug)]
pub struct GraphTeamValue(TeamGraph<AnyEngine>);

impl GraphTeamValue {
    /// Reads an ONNX file for tract. Only the rows that a query attends to, and its own, are given to the graph.
    pub fn by_tract(onnx: &[u8]) -> Result<Self, CompileError> {
        Self::open(&Graph::read(onnx)?, &Tract)
    }

    /// The same for onnxruntime.
    pub fn by_onnxruntime(runtime: &OnnxRuntime, onnx: &[u8]) -> Result<Self, CompileError> {
        Self::open(&Graph::read(onnx)?, runtime)
    }

    pub(crate) fn open<O: Opens>(graph: &Graph, opener: &O) -> Result<Self, CompileError>
    where
        O::Engine: Engine<Number = f32>,
    {
        graph.team_roles()?;
        let engine: AnyEngine = Box::new(opener.open(graph)?);
        Ok(Self(TeamGraph::new(graph, engine)?))
    }

    /// Features d of an entity and columns F of its relation.
    pub fn columns(&self) -> (usize, usize) {
        (self.0.roles.features, self.0.roles.relations)
    }
}

impl TeamValueNetwork for GraphTeamValue {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        self.0.check_finite(query)?;
        let value = self.0.run(query, Rows::Visible)?;
        if value.is_finite() { Ok(value) } else { Err(AllocateError::NonFinite) }
    }
}
