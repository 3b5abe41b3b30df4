//! The graphs of an allocator that proposes: the trunk once, the step for every agent of every proposal, the critic for
//! every proposal.

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::value::Tensor;
use sortie_core::allocate::proposals::Draw;
use sortie_core::{AllocateError, AllocationState};

use super::{OnnxRuntime, refused};
use crate::graph::Graph;
use sortie_plans::CompileError;
use sortie_plans::ProposalFiles;

/// Trunk, step and critic, run by onnxruntime for states of one size.
#[derive(Debug)]
pub struct OnnxRuntimeProposals {
    trunk: OverEntities,
    step: Step,
    critic: OverEntities,
    tasks: usize,
    width: usize,
}

/// A graph over all entities.
#[derive(Debug)]
struct OverEntities {
    session: Session,
    binding: IoBinding,
    entities: Tensor<f32>,
    entity_task: Tensor<f32>,
    present: Tensor<bool>,
    is_agent: Tensor<bool>,
}

/// The graph of one agent's choice.
#[derive(Debug)]
struct Step {
    session: Session,
    binding: IoBinding,
    agent: Tensor<f32>,
    task_embedding: Tensor<f32>,
    task_count: Tensor<f32>,
    agent_count: Tensor<f32>,
    open: Tensor<bool>,
}

impl OnnxRuntimeProposals {
    /// Reads the files, for states of `entities` entities.
    pub fn new(
        runtime: &OnnxRuntime,
        files: &ProposalFiles<'_>,
        entities: usize,
    ) -> Result<Self, CompileError> {
        let trunk = Graph::read(files.trunk)?;
        let (features, roles) = (trunk.columns, trunk.proposal_roles()?);
        let (tasks, width) = (roles.tasks, Graph::read(files.step)?.columns);
        let over = |onnx, outputs: &[(&str, &[usize])]| {
            let session = runtime.session(onnx)?;
            OverEntities::new(session, [entities, features, tasks], outputs).map_err(refused)
        };
        let rows = [entities, width];
        let outputs: [(&str, &[usize]); 3] =
            [("embedding", &rows), ("task_embedding", &[tasks, width]), ("task_count", &[tasks])];
        Ok(Self {
            trunk: over(files.trunk, &outputs)?,
            step: Step::new(runtime.session(files.step)?, tasks, width).map_err(refused)?,
            critic: over(files.critic, &[("value", &[1])])?,
            tasks,
            width,
        })
    }

    /// Proposes allocations as `draw` says, as many as there are values; all agents are present. Returns the best.
    pub fn propose(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut dyn Draw,
        values: &mut [f32],
    ) -> Result<Vec<u8>, AllocateError> {
        self.run(state, draw, values).map_err(|_| AllocateError::BadLength)
    }

    fn run(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut dyn Draw,
        values: &mut [f32],
    ) -> ort::Result<Vec<u8>> {
        let Self { trunk, step, critic, tasks, width } = self;
        trunk.write(state, |row| state.entity_task[row]);
        critic.write(state, |row| state.entity_task[row]);
        let outputs = trunk.session.run_binding(&trunk.binding)?;
        let number = |name: &str| -> ort::Result<Vec<f32>> {
            Ok(outputs[name].try_extract_tensor::<f32>()?.1.to_vec())
        };
        let read = || -> ort::Result<_> {
            Ok((number("embedding")?, number("task_embedding")?, number("task_count")?))
        };
        let (embedding, first, counts): (Vec<f32>, Vec<f32>, Vec<f32>) = read()?;
        drop(outputs);
        step.task_count.extract_tensor_mut().1.copy_from_slice(&counts);
        for (task, open) in step.open.extract_tensor_mut().1.iter_mut().enumerate() {
            *open = state.open_tasks >> task & 1 == 1;
        }
        let (mut best, mut allocation) = (f32::NEG_INFINITY, vec![0; state.agents]);
        for (proposal, value) in values.iter_mut().enumerate() {
            let mut places = vec![0_u8; state.agents];
            step.task_embedding.extract_tensor_mut().1.copy_from_slice(&first);
            step.agent_count.extract_tensor_mut().1.fill(0.0);
            for (agent, place) in places.iter_mut().enumerate() {
                let own = &embedding[agent * *width..][..*width];
                step.agent.extract_tensor_mut().1.copy_from_slice(own);
                let outputs = step.session.run_binding(&step.binding)?;
                let (_, log_pi) = outputs["log_pi"].try_extract_tensor::<f32>()?;
                let task = draw.draw(proposal, agent, log_pi, state.open_tasks).min(*tasks - 1);
                let (_, changed) =
                    outputs["task_embedding_if_chosen"].try_extract_tensor::<f32>()?;
                let range = task * *width..(task + 1) * *width;
                step.task_embedding.extract_tensor_mut().1[range.clone()]
                    .copy_from_slice(&changed[range]);
                step.agent_count.extract_tensor_mut().1[task] += 1.0;
                *place = task as u8;
            }
            let (_, entity_task) = critic.entity_task.extract_tensor_mut();
            for (row, place) in entity_task.chunks_exact_mut(*tasks).zip(&places) {
                row.fill(0.0);
                row[usize::from(*place)] = 1.0;
            }
            let outputs = critic.session.run_binding(&critic.binding)?;
            *value = outputs["value"].try_extract_tensor::<f32>()?.1[0];
            if *value > best {
                (best, allocation) = (*value, places);
            }
        }
        Ok(allocation)
    }
}

impl OverEntities {
    fn new(
        session: Session,
        [entities, features, tasks]: [usize; 3],
        outputs: &[(&str, &[usize])],
    ) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut binding = session.create_binding()?;
        let rows = Tensor::new(allocator, [entities, features])?;
        let entity_task = Tensor::new(allocator, [entities, tasks])?;
        let (present, is_agent) =
            (Tensor::new(allocator, [entities])?, Tensor::new(allocator, [entities])?);
        binding.bind_input("entities", &rows)?;
        binding.bind_input("entity_task", &entity_task)?;
        binding.bind_input("present", &present)?;
        binding.bind_input("is_agent", &is_agent)?;
        for (name, shape) in outputs {
            binding.bind_output(*name, Tensor::<f32>::new(allocator, shape.to_vec())?)?;
        }
        Ok(Self { session, binding, entities: rows, entity_task, present, is_agent })
    }

    fn write(&mut self, state: &AllocationState<'_>, tasks_of: impl Fn(usize) -> u32) {
        let (shape, rows) = self.entities.extract_tensor_mut();
        let features = shape[1] as usize;
        for (to, from) in rows.chunks_exact_mut(features).zip(state.rows.chunks(state.stride)) {
            to.copy_from_slice(&from[..features]);
        }
        let (shape, belongs) = self.entity_task.extract_tensor_mut();
        let tasks = shape[1] as usize;
        for (row, to) in belongs.chunks_exact_mut(tasks).enumerate() {
            for (task, to) in to.iter_mut().enumerate() {
                *to = (tasks_of(row) >> task & 1) as f32;
            }
        }
        for (row, to) in self.present.extract_tensor_mut().1.iter_mut().enumerate() {
            *to = state.present.contains(row);
        }
        for (row, to) in self.is_agent.extract_tensor_mut().1.iter_mut().enumerate() {
            *to = row < state.agents;
        }
    }
}

impl Step {
    fn new(session: Session, tasks: usize, width: usize) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut binding = session.create_binding()?;
        let agent = Tensor::new(allocator, [width])?;
        let task_embedding = Tensor::new(allocator, [tasks, width])?;
        let counts = || Tensor::new(allocator, [tasks]);
        let (task_count, agent_count) = (counts()?, counts()?);
        let open = Tensor::new(allocator, [tasks])?;
        binding.bind_input("agent_embedding", &agent)?;
        binding.bind_input("task_embedding", &task_embedding)?;
        binding.bind_input("task_count", &task_count)?;
        binding.bind_input("agent_count", &agent_count)?;
        binding.bind_input("task_open", &open)?;
        binding.bind_output("log_pi", Tensor::<f32>::new(allocator, [tasks])?)?;
        let changed = Tensor::<f32>::new(allocator, [tasks, width])?;
        binding.bind_output("task_embedding_if_chosen", changed)?;
        Ok(Self { session, binding, agent, task_embedding, task_count, agent_count, open })
    }
}
