//! The graph of an allocator, a team at a time.

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::value::Tensor;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::{AllocateError, limits};

use super::{OnnxRuntime, run_bound};
use crate::engine::{TeamValueEngine, checked_value};
use crate::graph::{Graph, TeamRoles};
use sortie_plans::CompileError;
use sortie_plans::Rows;

/// A team-value network that runs the ONNX graph with onnxruntime.
#[derive(Debug)]
pub struct OnnxRuntimeTeamValue {
    session: Session,
    names: Names,
    roles: TeamRoles,
    /// Bound tensors by number of rows.
    bound: Vec<Option<Bound>>,
}

/// How the file calls its inputs and its output; masks in the order of [`TeamRoles::masks`].
#[derive(Clone, Debug)]
struct Names {
    entities: String,
    relation: String,
    masks: [String; 5],
    value: String,
}

/// The tensors of one number of rows, and the binding that refers to them.
#[derive(Debug)]
struct Bound {
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
        let output = session.outputs.last().map(|output| output.name.clone());
        let names = Names {
            entities: graph.input_name(roles.entities),
            relation: graph.input_name(roles.relation),
            masks: roles.masks().map(|mask| graph.input_name(mask)),
            value: output.unwrap_or_default(),
        };
        let bound = (0..=limits::ENTITIES).map(|_| None).collect();
        Ok(Self { session, names, roles, bound })
    }
}

impl Bound {
    fn new(session: &Session, names: &Names, roles: &TeamRoles, rows: usize) -> ort::Result<Self> {
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
            let new = Bound::new(session, names, roles, rows.len());
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
