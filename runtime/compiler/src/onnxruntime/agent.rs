//! The graphs of one agent, and of an allocator, a team at a time.

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::value::Tensor;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::choose::masked_argmax;
use sortie_core::{AllocateError, DecideError, Decision, Observation, Policy, limits};
use sortie_plans::{CompileError, Rows};

use super::{OnnxRuntime, run_bound};
use crate::graph::inputs::{
    AgentColumns, AgentEngine, TeamValueEngine, checked_utilities, checked_value,
};
use crate::graph::{Graph, TeamRoles};

/// A policy that runs the ONNX graph with onnxruntime.
#[derive(Debug)]
pub struct OnnxRuntimePolicy {
    session: Session,
    names: Names,
    columns: AgentColumns,
    /// Bound tensors by number of rows.
    bound: Vec<Option<Bound>>,
    utilities: Vec<f32>,
}

/// How the file calls its inputs and its output.
#[derive(Clone, Debug)]
struct Names {
    entities: String,
    self_index: String,
    visible: String,
    utilities: String,
}

/// The tensors of one number of rows, and the binding that refers to them.
#[derive(Debug)]
struct Bound {
    binding: IoBinding,
    entities: Tensor<f32>,
    self_index: Tensor<i64>,
    visible: Tensor<bool>,
}

impl OnnxRuntimePolicy {
    /// Reads an ONNX file; `features` is the number d of columns before the last action's one-hot. An agent with
    /// memory is refused.
    pub fn new(runtime: &OnnxRuntime, onnx: &[u8], features: usize) -> Result<Self, CompileError> {
        Self::of_variant(runtime, onnx, onnx, features)
    }

    /// Runs `variant`, which has the inputs and outputs of `onnx`: the same network quantised, for example.
    pub fn of_variant(
        runtime: &OnnxRuntime,
        onnx: &[u8],
        variant: &[u8],
        features: usize,
    ) -> Result<Self, CompileError> {
        let graph = Graph::read(onnx)?;
        let roles = graph.agent_roles()?;
        if let Some(memory) = roles.memory {
            let (what, got) = ("the recurrent state".into(), memory.size);
            return Err(CompileError::Size { what, got, want: 0 });
        }
        let columns = AgentColumns::new(graph.columns, features, graph.actions)?;
        let session = runtime.session(variant)?;
        let names = Names {
            entities: graph.input_name(roles.entities),
            self_index: graph.input_name(roles.self_index),
            visible: graph.input_name(roles.visible),
            utilities: last_output(&session),
        };
        let bound = (0..=limits::ENTITIES).map(|_| None).collect();
        Ok(Self { session, names, columns, bound, utilities: vec![0.0; graph.actions] })
    }
}

impl Bound {
    /// The session's own allocator makes all tensors: outputs can be bound only if it did.
    fn new(
        session: &Session,
        names: &Names,
        (rows, columns, actions): (usize, usize, usize),
    ) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut bound = Self {
            binding: session.create_binding()?,
            entities: Tensor::new(allocator, [rows, columns])?,
            self_index: Tensor::new(allocator, [1_usize])?,
            visible: Tensor::new(allocator, [rows])?,
        };
        bound.binding.bind_input(&names.entities, &bound.entities)?;
        bound.binding.bind_input(&names.self_index, &bound.self_index)?;
        bound.binding.bind_input(&names.visible, &bound.visible)?;
        let utilities = Tensor::<f32>::new(allocator, [actions])?;
        bound.binding.bind_output(&names.utilities, utilities)?;
        Ok(bound)
    }
}

impl AgentEngine for OnnxRuntimePolicy {
    fn columns(&self) -> AgentColumns {
        self.columns
    }

    fn run(
        &mut self,
        observation: &Observation<'_>,
        rows: Rows,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let Self { session, names, columns, bound, .. } = self;
        let rows = columns.rows(observation, rows)?;
        let slot = bound.get_mut(rows.len()).ok_or(DecideError::BadLength)?;
        if slot.is_none() {
            let shape = (rows.len(), columns.columns, utilities.len());
            let new = Bound::new(session, names, shape).map_err(|_| DecideError::BadLength);
            *slot = Some(new?);
        }
        let bound = slot.as_mut().ok_or(DecideError::BadLength)?;
        let (_, entities) = bound.entities.extract_tensor_mut();
        let (_, visible) = bound.visible.extract_tensor_mut();
        let own = columns.write(observation, &rows, entities, visible)?;
        bound.self_index.extract_tensor_mut().1.fill(own);
        // What onnxruntime may refuse are sizes that the graph cannot take.
        run_bound(session, &bound.binding, utilities).ok_or(DecideError::BadLength)
    }
}

impl Policy for OnnxRuntimePolicy {
    fn actions(&self) -> usize {
        self.utilities.len()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        checked_utilities(self, observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = std::mem::take(&mut self.utilities);
        let chosen = self
            .utilities(observation, &mut utilities)
            .and_then(|()| masked_argmax(&utilities, observation.available));
        self.utilities = utilities;
        chosen
    }
}

/// What a graph answers.
fn last_output(session: &Session) -> String {
    session.outputs.last().map(|output| output.name.clone()).unwrap_or_default()
}

/// A team-value network that runs the ONNX graph with onnxruntime.
#[derive(Debug)]
pub struct OnnxRuntimeTeamValue {
    session: Session,
    names: TeamNames,
    roles: TeamRoles,
    /// TeamBound tensors by number of rows.
    bound: Vec<Option<TeamBound>>,
}

/// How the file calls its inputs and its output; masks in the order of [`TeamRoles::masks`].
#[derive(Clone, Debug)]
struct TeamNames {
    entities: String,
    relation: String,
    masks: [String; 5],
    value: String,
}

/// The tensors of one number of rows, and the binding that refers to them.
#[derive(Debug)]
struct TeamBound {
    binding: IoBinding,
    entities: Tensor<f32>,
    relation: Tensor<f32>,
    masks: [Tensor<bool>; 5],
}

impl OnnxRuntimeTeamValue {
    /// Reads an ONNX file. Only the rows that the query attends to, and its own, are given to the graph.
    pub fn new(runtime: &OnnxRuntime, onnx: &[u8]) -> Result<Self, CompileError> {
        let graph = Graph::read(onnx)?;
        let roles = graph.team_roles()?;
        let session = runtime.session(onnx)?;
        let names = TeamNames {
            entities: graph.input_name(roles.entities),
            relation: graph.input_name(roles.relation),
            masks: roles.masks().map(|mask| graph.input_name(mask)),
            value: last_output(&session),
        };
        let bound = (0..=limits::ENTITIES).map(|_| None).collect();
        Ok(Self { session, names, roles, bound })
    }
}

impl TeamBound {
    fn new(
        session: &Session,
        names: &TeamNames,
        roles: &TeamRoles,
        rows: usize,
    ) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mask = || Tensor::new(allocator, [rows]);
        let mut bound = Self {
            binding: session.create_binding()?,
            entities: Tensor::new(allocator, [rows, roles.features])?,
            relation: Tensor::new(allocator, [rows, roles.relations])?,
            masks: [mask()?, mask()?, mask()?, mask()?, mask()?],
        };
        bound.binding.bind_input(&names.entities, &bound.entities)?;
        bound.binding.bind_input(&names.relation, &bound.relation)?;
        for (name, mask) in names.masks.iter().zip(&bound.masks) {
            bound.binding.bind_input(name, mask)?;
        }
        bound.binding.bind_output(&names.value, Tensor::<f32>::new(allocator, [1_usize])?)?;
        Ok(bound)
    }
}

impl TeamValueEngine for OnnxRuntimeTeamValue {
    fn roles(&self) -> TeamRoles {
        self.roles
    }

    fn run(&mut self, query: &TeamQuery<'_>, rows: Rows) -> Result<f32, AllocateError> {
        let Self { session, names, roles, bound } = self;
        let rows = roles.rows(query, rows)?;
        let slot = bound.get_mut(rows.len()).ok_or(AllocateError::TooLarge)?;
        if slot.is_none() {
            let new = TeamBound::new(session, names, roles, rows.len());
            *slot = Some(new.map_err(|_| AllocateError::BadLength)?);
        }
        let bound = slot.as_mut().ok_or(AllocateError::BadLength)?;
        let (_, entities) = bound.entities.extract_tensor_mut();
        let (_, relation) = bound.relation.extract_tensor_mut();
        let masks = bound.masks.each_mut().map(|mask| mask.extract_tensor_mut().1);
        roles.write(query, &rows, entities, relation, masks)?;
        // What onnxruntime may refuse are sizes that the graph cannot take.
        let mut value = [0.0];
        let ran = run_bound(session, &bound.binding, &mut value);
        ran.map(|()| value[0]).ok_or(AllocateError::BadLength)
    }
}

impl TeamValueNetwork for OnnxRuntimeTeamValue {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        checked_value(self, query)
    }
}
