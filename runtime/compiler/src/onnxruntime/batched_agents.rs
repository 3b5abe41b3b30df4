//! All agents of a process in one call.

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::value::Tensor;
use sortie_core::{DecideError, EntityMask, Observation};

use super::{OnnxRuntime, batched_agents_onnx, refused, run_bound};
use crate::graph::Graph;
use crate::graph::inputs::AgentColumns;
use sortie_plans::CompileError;

/// An agent's network that answers for all agents of a frame at once, see [`batched_agents_onnx`].
#[derive(Debug)]
pub struct BatchedAgents {
    session: Session,
    columns: AgentColumns,
    actions: usize,
    bound: Vec<Bound>,
}

/// The tensors of one shape, and the binding that refers to them.
#[derive(Debug)]
struct Bound {
    agents: usize,
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
        Ok(Self { session, columns, actions, bound: Vec::new() })
    }

    /// Writes the utilities `[B, U]` of the agents of one frame: their observations have the same rows.
    pub fn utilities(
        &mut self,
        frame: &[Observation<'_>],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let first = frame.first().ok_or(DecideError::BadLength)?;
        let rows = first.rows.len() / first.stride.max(1);
        let place = self.place(frame.len(), rows).map_err(|_| DecideError::BadLength)?;
        let Self { session, columns, bound, .. } = self;
        let bound = bound.get_mut(place).ok_or(DecideError::BadLength)?;
        bound.write(*columns, frame)?;
        run_bound(session, &bound.binding, utilities).ok_or(DecideError::BadLength)
    }

    /// The place of the tensors of a shape, which are bound at the first use.
    fn place(&mut self, agents: usize, rows: usize) -> Result<usize, CompileError> {
        let fits = |bound: &Bound| bound.agents == agents && bound.rows == rows;
        if let Some(place) = self.bound.iter().position(fits) {
            return Ok(place);
        }
        let shape = [agents, rows, self.columns.columns, self.actions];
        self.bound.push(Bound::new(&self.session, shape).map_err(refused)?);
        Ok(self.bound.len() - 1)
    }
}

impl Bound {
    fn new(session: &Session, [agents, rows, columns, actions]: [usize; 4]) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut bound = Self {
            agents,
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
