//! The graphs of an allocator that proposes: the trunk once, the step for every agent of every proposal, the critic for
//! every proposal.

use sortie_core::allocate::proposals::Draw;
use sortie_core::{AllocateError, AllocationState, UNASSIGNED};
use sortie_plans::{CompileError, cannot_run};

use super::{Opens, feature_rows};
use crate::engine::{Engine, Tensors, flag};
use crate::graph::{Graph, ProposalRoles};

/// Trunk, step and critic in an engine.
#[derive(Debug)]
pub(crate) struct ProposalGraphs<E: Engine> {
    trunk: OverEntities<E>,
    step: E,
    critic: OverEntities<E>,
    features: usize,
    tasks: usize,
    /// An agent's embedding, the subtasks' embeddings, counts of their entities and of their agents, which are open.
    step_tensors: Tensors<E::Number>,
}

/// A graph over all entities: features, subtasks, presence, and who is an agent.
#[derive(Debug)]
struct OverEntities<E: Engine> {
    engine: E,
    tensors: Tensors<E::Number>,
}

/// What all proposals for a state have in common.
#[derive(Debug)]
struct Scene<N> {
    embedding: Vec<N>,
    task_embedding: Vec<N>,
    task_count: Vec<N>,
    width: usize,
}

/// How a proposal goes for one agent.
#[derive(Clone, Copy)]
struct Turn<'a, N> {
    agent: usize,
    /// The logarithms of its subtasks' probabilities `[T]`.
    log_pi: &'a [N],
}

impl<E: Engine> ProposalGraphs<E> {
    pub(crate) fn new<O: Opens<Engine = E>>(
        graphs: [&Graph; 3],
        opener: &O,
    ) -> Result<Self, CompileError> {
        let [trunk, step, critic] = graphs;
        let over = |graph: &Graph| -> Result<_, CompileError> {
            let ProposalRoles { entities, groups, present, agent, .. } = graph.proposal_roles()?;
            let names = [entities, groups, present, agent].map(|input| graph.input_name(input));
            Ok(OverEntities { engine: opener.open(graph)?, tensors: Tensors::new(names) })
        };
        let roles = step.proposal_roles()?;
        let inputs = [roles.agent, roles.entities, roles.groups, roles.counts, roles.present];
        Ok(Self {
            trunk: over(trunk)?,
            step: opener.open(step)?,
            critic: over(critic)?,
            features: trunk.columns,
            tasks: roles.tasks,
            step_tensors: Tensors::new(inputs.map(|input| step.input_name(input))),
        })
    }

    /// Its engines.
    pub(crate) fn engines(&mut self) -> Vec<&mut E> {
        vec![&mut self.trunk.engine, &mut self.step, &mut self.critic.engine]
    }

    /// Goes through allocations as the policy would: the logarithms of the probabilities that every present agent had
    /// for the open subtasks, and the values of all.
    pub(crate) fn judge(
        &mut self,
        state: &AllocationState<'_>,
        allocations: &[Vec<u8>],
    ) -> Result<Vec<Vec<E::Number>>, CompileError> {
        if allocations.is_empty() {
            return Ok(Vec::new());
        }
        let scene = self.scene(state)?;
        let (mut probabilities, mut values) = (Vec::new(), Vec::new());
        for allocation in allocations {
            let mut choose = |turn: Turn<'_, E::Number>| {
                let open = turn.log_pi.iter().enumerate();
                let open = open.filter(|(task, _)| state.open_tasks >> task & 1 == 1);
                probabilities.extend(open.map(|(_, log_pi)| *log_pi));
                allocation.get(turn.agent).copied().unwrap_or(UNASSIGNED)
            };
            let places = self.propose(state, &scene, &mut choose)?;
            values.push(self.value(state, &places)?);
        }
        Ok(vec![probabilities, values])
    }

    /// What all proposals have in common.
    fn scene(&mut self, state: &AllocationState<'_>) -> Result<Scene<E::Number>, CompileError> {
        let belongs = |row: usize| state.entity_task.get(row).copied().unwrap_or(0);
        let outputs = self.trunk.run(state, [self.features, self.tasks], &belongs)?;
        let outputs: [_; 3] =
            outputs.try_into().map_err(|_| cannot_run("a trunk has three outputs"))?;
        let [embedding, task_embedding, task_count] = outputs;
        let width = embedding.len() / state.entity_task.len().max(1);
        Ok(Scene { embedding, task_embedding, task_count, width })
    }

    /// Lets present agents choose one after the other; the subtask of each.
    fn propose(
        &mut self,
        state: &AllocationState<'_>,
        scene: &Scene<E::Number>,
        choose: &mut dyn FnMut(Turn<'_, E::Number>) -> u8,
    ) -> Result<Vec<u8>, CompileError> {
        let Self { step, tasks, step_tensors: tensors, .. } = self;
        let (tasks, width) = (*tasks, scene.width);
        let mut task_embedding = scene.task_embedding.clone();
        let mut agent_count = vec![0.0_f32; tasks];
        let mut places = vec![UNASSIGNED; state.agents];
        for agent in (0..state.agents).filter(|agent| state.present.contains(*agent)) {
            let own = scene.embedding.chunks(width.max(1)).nth(agent).unwrap_or_default();
            tensors.copy(0, &[width], own);
            tensors.copy(1, &[tasks, width], &task_embedding);
            tensors.copy(2, &[tasks], &scene.task_count);
            tensors.fill(3, &[tasks], agent_count.iter().copied());
            let is_open = |task: usize| flag(state.open_tasks >> task & 1 == 1);
            tensors.fill(4, &[tasks], (0..tasks).map(is_open));
            let outputs = step.run(&tensors.named())?;
            let [log_pi, changed] = outputs.as_slice() else {
                return Err(cannot_run("a step has two outputs"));
            };
            let place = choose(Turn { agent, log_pi });
            let task = usize::from(place);
            let range = task * width..(task + 1) * width;
            if let (Some(to), Some(from)) =
                (task_embedding.get_mut(range.clone()), changed.get(range))
            {
                to.copy_from_slice(from);
            }
            agent_count.iter_mut().skip(task).take(1).for_each(|count| *count += 1.0);
            if let Some(to) = places.get_mut(agent) {
                *to = place;
            }
        }
        Ok(places)
    }

    /// What an allocation is worth.
    fn value(
        &mut self,
        state: &AllocationState<'_>,
        places: &[u8],
    ) -> Result<E::Number, CompileError> {
        let belongs = |row: usize| match places.get(row) {
            Some(task) => 1_u32.checked_shl(u32::from(*task)).unwrap_or(0),
            None => state.entity_task.get(row).copied().unwrap_or(0),
        };
        let outputs = self.critic.run(state, [self.features, self.tasks], &belongs)?;
        let value = outputs.first().and_then(|value| value.first()).copied();
        value.ok_or_else(|| cannot_run("a critic gives a value"))
    }
}

impl<E: Engine<Number = f32>> ProposalGraphs<E> {
    /// Proposes allocations as `draw` says, as many as there are values. Returns the best.
    pub(crate) fn draw(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut dyn Draw,
        values: &mut [f32],
    ) -> Result<Vec<u8>, AllocateError> {
        let failed = |_: CompileError| AllocateError::BadLength;
        let scene = self.scene(state).map_err(failed)?;
        let (mut best, mut allocation) = (f32::NEG_INFINITY, vec![0; state.agents]);
        for (proposal, value) in values.iter_mut().enumerate() {
            let mut choose = |Turn { agent, log_pi }: Turn<'_, f32>| {
                draw.draw(proposal, agent, log_pi, state.open_tasks) as u8
            };
            let places = self.propose(state, &scene, &mut choose).map_err(failed)?;
            *value = self.value(state, &places).map_err(failed)?;
            if *value > best {
                (best, allocation) = (*value, places);
            }
        }
        Ok(allocation)
    }
}

impl<E: Engine> OverEntities<E> {
    fn run(
        &mut self,
        state: &AllocationState<'_>,
        [features, tasks]: [usize; 2],
        tasks_of: &dyn Fn(usize) -> u32,
    ) -> Result<Vec<Vec<E::Number>>, CompileError> {
        let Self { engine, tensors } = self;
        let count = state.entity_task.len();
        let rows = feature_rows(0..count, state.rows, state.stride, features);
        tensors.fill(0, &[count, features], rows.map_err(cannot_run)?);
        let bit = |row: usize, task: usize| flag(tasks_of(row) >> task & 1 == 1);
        let belongs = (0..count).flat_map(|row| (0..tasks).map(move |task| bit(row, task)));
        tensors.fill(1, &[count, tasks], belongs);
        tensors.fill(2, &[count], (0..count).map(|row| flag(state.present.contains(row))));
        tensors.fill(3, &[count], (0..count).map(|row| flag(row < state.agents)));
        engine.run(&tensors.named())
    }
}
