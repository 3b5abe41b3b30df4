//! The source graphs of an allocator that proposes, run by tract: the reference for plans.

use sortie_core::{AllocationState, UNASSIGNED};
use sortie_plans::CompileError;
use tract_onnx::prelude::*;

use super::{numbers, ordered};
use crate::graph::{Graph, ProposalRoles, guarded};

/// Trunk, step and critic, run by tract a proposal at a time. It allocates.
#[derive(Debug)]
pub(crate) struct TractProposals {
    graphs: [(TypedSimpleState, ProposalRoles); 3],
    features: usize,
}

/// What the policy and the critic say about one allocation.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Judged {
    /// The logarithms of the probabilities `[present agents, T]` that the agents had for every subtask.
    pub(crate) log_pi: Vec<f32>,
    pub(crate) value: f32,
}

impl TractProposals {
    pub(crate) fn from_graphs(graphs: [&Graph; 3]) -> Result<Self, CompileError> {
        let [trunk, step, critic] = graphs;
        let open = |graph: &Graph| -> Result<_, CompileError> {
            Ok((graph.runnable()?, graph.proposal_roles()?))
        };
        let features = trunk.columns;
        Ok(Self { graphs: [open(trunk)?, open(step)?, open(critic)?], features })
    }

    /// Goes through an allocation `[A]` as the policy would.
    pub(crate) fn judge(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &[u8],
    ) -> Result<Judged, CompileError> {
        guarded(|| self.run(state, allocation)).map_err(|reason| CompileError::Run { reason })
    }

    fn run(&mut self, state: &AllocationState<'_>, allocation: &[u8]) -> TractResult<Judged> {
        let [trunk, step, critic] = &mut self.graphs;
        let tasks = step.1.tasks;
        let count = state.entity_task.len();
        let rows = state.rows.chunks(state.stride.max(1)).take(count);
        let features = self.features;
        let rows: Vec<f32> = rows.flat_map(|row| row.iter().take(features)).copied().collect();
        let entities = Tensor::from_shape(&[count, features], &rows)?;
        let mask = |holds: &dyn Fn(usize) -> bool| {
            Tensor::from_shape(&[count], &(0..count).map(holds).collect::<Vec<bool>>())
        };
        let (present, agents) =
            (mask(&|row| state.present.contains(row))?, mask(&|row| row < state.agents)?);
        let belongs = |tasks_of: &dyn Fn(usize) -> u32| {
            let bits = |row| (0..tasks).map(move |task| (row, task));
            let bit = |(row, task): (usize, usize)| (tasks_of(row) >> task & 1) as f32;
            Tensor::from_shape(
                &[count, tasks],
                &(0..count).flat_map(bits).map(bit).collect::<Vec<f32>>(),
            )
        };
        let last = |row: usize| state.entity_task.get(row).copied().unwrap_or(0);
        let place = |row: usize| allocation.get(row).copied().unwrap_or(UNASSIGNED);
        let proposed = |row: usize| match place(row) {
            _ if row >= state.agents => last(row),
            task => 1_u32.checked_shl(task.into()).unwrap_or(0),
        };
        let over_entities = |roles: &ProposalRoles, belongs: Tensor| {
            ordered(vec![
                (roles.entities, entities.clone()),
                (roles.groups, belongs),
                (roles.present, present.clone()),
                (roles.agent, agents.clone()),
            ])
        };
        let outputs = trunk.0.run(over_entities(&trunk.1, belongs(&last)?))?;
        let [embedding, task_embedding, task_count] = outputs
            .iter()
            .map(numbers)
            .collect::<TractResult<Vec<_>>>()?
            .try_into()
            .map_err(|_| TractError::msg("a trunk has three outputs"))?;
        let width = embedding.len() / count.max(1);
        let mut task_embedding = task_embedding;
        let mut agent_count = vec![0.0_f32; tasks];
        let open: Vec<bool> = (0..tasks).map(|task| state.open_tasks >> task & 1 == 1).collect();
        let mut log_pi = Vec::new();
        for agent in (0..state.agents).filter(|agent| state.present.contains(*agent)) {
            let own = embedding.chunks(width.max(1)).nth(agent).unwrap_or_default();
            let roles = &step.1;
            let inputs = vec![
                (roles.agent, Tensor::from_shape(&[width], own)?),
                (roles.entities, Tensor::from_shape(&[tasks, width], &task_embedding)?),
                (roles.groups, Tensor::from_shape(&[tasks], &task_count)?),
                (roles.counts, Tensor::from_shape(&[tasks], &agent_count)?),
                (roles.present, Tensor::from_shape(&[tasks], &open)?),
            ];
            let outputs = step.0.run(ordered(inputs))?;
            let [all, changed] = outputs.as_slice() else { continue };
            log_pi.extend(numbers(all)?);
            let task = usize::from(place(agent));
            let range = task * width..(task + 1) * width;
            let changed = numbers(changed)?;
            if let (Some(to), Some(from)) =
                (task_embedding.get_mut(range.clone()), changed.get(range))
            {
                to.copy_from_slice(from);
            }
            agent_count.iter_mut().skip(task).take(1).for_each(|count| *count += 1.0);
        }
        let outputs = critic.0.run(over_entities(&critic.1, belongs(&proposed)?))?;
        let value = outputs.first().map(numbers).transpose()?.unwrap_or_default();
        Ok(Judged { log_pi, value: value.first().copied().unwrap_or(f32::NAN) })
    }
}
