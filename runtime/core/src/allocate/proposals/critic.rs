//! What each proposal is worth (dissertation section 7.4).
//!
//! An entity's row depends only on the entity, its subtask, and how many agents work there: rows that several
//! allocations have in common are computed once, and so is an allocation that was proposed more than once.

use super::memory::{CriticMemory, Grid, NONE, StepMemory};
use super::scene::{Near, Product, Scene, add, copy, refused, tasks_in, vector};
use crate::allocator::AllocateError;
use crate::kernels::Kernels;
use crate::limits;
use crate::math::relu_all;

/// Writes the value of every proposal.
#[inline(always)]
pub(super) fn score(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    step: &StepMemory<'_>,
    memory: &mut CriticMemory<'_>,
    scores: &mut Grid<'_, f32>,
) -> Result<(), AllocateError> {
    let allocations = find_distinct(scene, step, memory);
    let rows = embed_rows(scene, step, memory, allocations)?;
    project(kernels, scene, memory, rows)?;
    attend(kernels, scene, memory, scores, allocations)?;
    value(kernels, scene, memory, allocations)
}

/// Numbers the distinct allocations and returns how many there are.
fn find_distinct(scene: &Scene<'_>, step: &StepMemory<'_>, memory: &mut CriticMemory<'_>) -> usize {
    let mut count = 0;
    for proposal in 0..scene.extent.proposals {
        let places = step.places.row(proposal);
        let known = memory.distinct.cells.iter().take(count);
        let mut known = known.map(|first| step.places.row(usize::from(*first)));
        let same = known.position(|other| other == places);
        let number = same.unwrap_or_else(|| {
            memory.distinct.set(0, count, proposal as u16);
            count += 1;
            count - 1
        });
        memory.same_as.set(0, proposal, number as u16);
    }
    count
}

/// How many distinct rows there are: those of agents stand before the others.
#[derive(Clone, Copy, Default)]
struct RowCount {
    agents: usize,
    all: usize,
}

/// Computes every distinct row once, and notes which rows each allocation has.
///
/// Rows of an entity at the same subtask stand side by side: they have many zeros in common.
#[inline(always)]
fn embed_rows(
    scene: &Scene<'_>,
    step: &StepMemory<'_>,
    memory: &mut CriticMemory<'_>,
    allocations: usize,
) -> Result<RowCount, AllocateError> {
    let embedding = Embedding::new(scene, step)?;
    let mut rows = RowCount::default();
    for (slot, entity) in scene.present.iter().enumerate() {
        if entity >= scene.state.agents {
            let set = scene.tasks_of(entity);
            let all = 0..allocations;
            rows.all = embedding.write_all(memory, [slot, entity], set, all, rows.all);
            continue;
        }
        let mut places = [NONE; limits::PROPOSALS];
        for (place, proposal) in
            places.iter_mut().zip(memory.distinct.cells.iter()).take(allocations)
        {
            *place = step.places.get(usize::from(*proposal), entity);
        }
        for task in 0..scene.tasks() {
            let here = places.iter().enumerate().take(allocations);
            let here = here.filter(|(_, place)| usize::from(**place) == task);
            let here = here.map(|(allocation, _)| allocation);
            rows.all = embedding.write_all(memory, [slot, entity], 1 << task, here, rows.all);
        }
        rows.agents = rows.all;
    }
    Ok(rows)
}

/// The critic's first layer.
struct Embedding<'a> {
    step: &'a StepMemory<'a>,
    /// `[T, E]`: what each subtask adds to an entity's features.
    tasks: &'a [f32],
    /// What each of its agents adds, each of its others, and what is always added.
    counts: &'a [f32],
    /// The others of each subtask.
    others: [f32; limits::TASKS],
}

impl<'a> Embedding<'a> {
    fn new(scene: &Scene<'a>, step: &'a StepMemory<'a>) -> Result<Self, AllocateError> {
        let critic = &scene.network.critic;
        let tasks = critic.tasks.of(scene.weights).map_err(refused)?;
        let counts = critic.counts.of(scene.weights).map_err(refused)?;
        let mut others = [0.0; limits::TASKS];
        for (task, others) in others.iter_mut().enumerate().take(scene.tasks()) {
            *others = scene.others_of(task) as f32;
        }
        Ok(Self { step, tasks, counts, others })
    }

    /// Writes the rows of an entity that belongs to the same subtasks in some allocations behind `rows` others, and
    /// returns how many there are then. One row stands for all allocations in which its subtask has as many agents.
    #[inline(always)]
    fn write_all(
        &self,
        memory: &mut CriticMemory<'_>,
        [slot, entity]: [usize; 2],
        set: u32,
        allocations: impl Iterator<Item = usize>,
        rows: usize,
    ) -> usize {
        let mut rows = rows;
        let several = set & set.wrapping_sub(1) != 0;
        let task = tasks_in(set).next();
        let mut row_of_count = [NONE; limits::AGENTS + 1];
        for allocation in allocations {
            let proposal = usize::from(memory.distinct.get(0, allocation));
            let agents = |task: usize| self.step.counts.get(task, proposal);
            let count = task.map_or(0, agents);
            let mut unknown = NONE;
            let row = row_of_count.get_mut(usize::from(count)).unwrap_or(&mut unknown);
            if several || *row == NONE {
                *row = rows as u16;
                self.write(memory, rows, entity, set, agents);
                rows += 1;
            }
            memory.rows_of.set(allocation, slot, *row);
        }
        rows
    }

    /// Writes the row of an entity that belongs to some subtasks with so many agents.
    #[inline(always)]
    fn write(
        &self,
        memory: &mut CriticMemory<'_>,
        row: usize,
        entity: usize,
        set: u32,
        agents: impl Fn(usize) -> u16,
    ) {
        let row = memory.rows.row_mut(row);
        let width = row.len();
        copy(memory.bases.row(entity), row);
        for task in tasks_in(set) {
            let others = self.others.get(task).copied().unwrap_or(0.0);
            let [per_agent, per_other, constant] =
                [0, 1, 2].map(|number| vector(self.counts, width, number));
            let counts = per_agent.iter().zip(per_other).zip(constant);
            let embedded = row.iter_mut().zip(vector(self.tasks, width, task)).zip(counts);
            let agents = f32::from(agents(task));
            for ((sum, task), ((per_agent, per_other), constant)) in embedded {
                *sum = *sum + task + agents * per_agent + others * per_other + constant;
            }
        }
        relu_all(row);
    }
}

/// Queries of agents, keys and values of all rows.
#[inline(always)]
fn project(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    memory: &mut CriticMemory<'_>,
    count: RowCount,
) -> Result<(), AllocateError> {
    let attention = &scene.network.critic.attention;
    let CriticMemory { rows, queries, keys, values, .. } = memory;
    let layer = |layer| Ok(Product::new(layer, scene.weights, false)?.behind_relu());
    layer(&attention.query)?.rows(kernels, rows, queries.cells, queries.width, 0..count.agents);
    layer(&attention.key)?.rows(kernels, rows, keys.cells, keys.width, 0..count.all);
    layer(&attention.value)?.rows(kernels, rows, values.cells, values.width, 0..count.all);
    Ok(())
}

/// Attention of every agent to all that exists, in every distinct allocation.
#[inline(always)]
fn attend(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    memory: &mut CriticMemory<'_>,
    scores: &mut Grid<'_, f32>,
    allocations: usize,
) -> Result<(), AllocateError> {
    let attention = &scene.network.critic.attention;
    let CriticMemory { queries, keys, values, mixed, rows_of, .. } = memory;
    let (count, agents) = (scene.present.len(), scene.present_agents().count());
    let mixed = mixed.cells.chunks_exact_mut((agents * mixed.width).max(1));
    for (allocation, mixed) in (0..allocations).zip(mixed) {
        let slots = rows_of.row(allocation).get(..count).ok_or(AllocateError::TooLarge)?;
        let askers = slots.get(..agents).ok_or(AllocateError::TooLarge)?;
        let near = Near { attention, keys, values, slots };
        near.attend(kernels, queries, askers, mixed, scores)?;
    }
    Ok(())
}

/// The mean over all agents, absent ones as zeros, and the last layer.
#[inline(always)]
fn value(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    memory: &mut CriticMemory<'_>,
    allocations: usize,
) -> Result<(), AllocateError> {
    let critic = &scene.network.critic;
    let agents = scene.present_agents().count();
    let CriticMemory { rows, mixed, mean, of_proposal, same_as, .. } = memory;
    let output = Product::new(&critic.attention.output, scene.weights, true)?;
    output.rows(kernels, mixed, rows.cells, rows.width, 0..allocations * agents);
    let slots = scene.state.agents.max(1) as f32;
    for allocation in 0..allocations {
        let sums = mean.row_mut(0);
        sums.fill(0.0);
        for agent in 0..agents {
            add(sums, rows.row(allocation * agents + agent));
        }
        sums.iter_mut().for_each(|sum| *sum /= slots);
        // Rows up to this one are in other means already.
        copy(sums, rows.row_mut(allocation));
    }
    let (head, width) = (&critic.head, critic.head.padded_outputs());
    let head = Product::new(head, scene.weights, false)?;
    head.rows(kernels, rows, mixed.cells, width, 0..allocations);
    for (of_proposal, same) in of_proposal.cells.iter_mut().zip(same_as.cells.iter()) {
        let value = vector(mixed.cells, width, usize::from(*same)).first();
        let value = value.copied().unwrap_or(f32::NAN);
        if !value.is_finite() {
            return Err(AllocateError::NonFinite);
        }
        *of_proposal = value;
    }
    Ok(())
}
