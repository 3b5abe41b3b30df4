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

/// Computes every distinct row once, notes which rows each allocation has, and returns how many rows there are.
#[inline(always)]
fn embed_rows(
    scene: &Scene<'_>,
    step: &StepMemory<'_>,
    memory: &mut CriticMemory<'_>,
    allocations: usize,
) -> Result<usize, AllocateError> {
    let critic = &scene.network.critic;
    let tasks = critic.tasks.of(scene.weights).map_err(refused)?;
    let counts = critic.counts.of(scene.weights).map_err(refused)?;
    let mut others = [0.0; limits::TASKS];
    for (task, others) in others.iter_mut().enumerate().take(scene.tasks()) {
        *others = scene.others_of(task) as f32;
    }
    memory.row_of_key.cells.fill(NONE);
    let mut rows = 0;
    for allocation in 0..allocations {
        let proposal = usize::from(memory.distinct.get(0, allocation));
        for (slot, entity) in scene.present.iter().enumerate() {
            let agents = |task: usize| step.counts.get(task, proposal);
            let set = match step.places.get(proposal, entity) {
                task if entity < scene.state.agents => 1_u32.checked_shl(task.into()).unwrap_or(0),
                _ => scene.tasks_of(entity),
            };
            let key = key(scene, entity, set, agents);
            let known = key.map_or(NONE, |key| memory.row_of_key.get(0, key));
            if known != NONE {
                memory.rows_of.set(allocation, slot, known);
                continue;
            }
            let row = memory.rows.row_mut(rows);
            let width = row.len();
            copy(memory.bases.row(entity), row);
            for task in tasks_in(set) {
                let others = others.get(task).copied().unwrap_or(0.0);
                let [per_agent, per_other, constant] = [0, 1, 2].map(|n| vector(counts, width, n));
                let counts = per_agent.iter().zip(per_other).zip(constant);
                let embedded = row.iter_mut().zip(vector(tasks, width, task)).zip(counts);
                let agents = f32::from(agents(task));
                for ((sum, task), ((per_agent, per_other), constant)) in embedded {
                    *sum = *sum + task + agents * per_agent + others * per_other + constant;
                }
            }
            relu_all(row);
            memory.entity_of.set(0, rows, entity as u16);
            memory.rows_of.set(allocation, slot, rows as u16);
            if let Some(key) = key {
                memory.row_of_key.set(0, key, rows as u16);
            }
            rows += 1;
        }
    }
    Ok(rows)
}

/// What a row depends on, as a number; none for those few that belong to several subtasks.
#[inline(always)]
fn key(scene: &Scene<'_>, entity: usize, set: u32, agents: impl Fn(usize) -> u16) -> Option<usize> {
    let (extent, tasks) = (scene.extent, scene.tasks());
    let task = tasks_in(set).next();
    if set & set.wrapping_sub(1) != 0 {
        return None;
    }
    let count = task.map_or(0, |task| usize::from(agents(task)));
    Some(match task {
        Some(task) if entity < scene.state.agents => extent.agent_key(tasks, entity, task, count),
        _ => extent.other_key(tasks, entity, count),
    })
}

/// Queries of agents, keys and values of all rows.
#[inline(always)]
fn project(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    memory: &mut CriticMemory<'_>,
    count: usize,
) -> Result<(), AllocateError> {
    let attention = &scene.network.critic.attention;
    let CriticMemory { rows, queries, keys, values, entity_of, .. } = memory;
    let layer = |layer| Ok(Product::new(layer, scene.weights, false)?.behind_relu());
    let is_agent = |row: &usize| usize::from(entity_of.get(0, *row)) < scene.state.agents;
    let agents = (0..count).filter(is_agent);
    layer(&attention.query)?.rows(kernels, rows, queries.cells, queries.width, agents);
    layer(&attention.key)?.rows(kernels, rows, keys.cells, keys.width, 0..count);
    layer(&attention.value)?.rows(kernels, rows, values.cells, values.width, 0..count);
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
