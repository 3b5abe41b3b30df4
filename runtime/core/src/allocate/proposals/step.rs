//! Proposals, agent by agent for all of them at once (dissertation section 7.4).
//!
//! A subtask's embedding depends only on the agents that chose it, in their order: it is a node of a tree, and proposals
//! that agree so far share it. Only the chosen subtask's embedding changes, and nobody asks for what the last agent
//! changes. What a node adds to those that become of it is the same whoever the agent: it is computed once, and not for
//! nodes that stay as they are. Counts enter the logits linearly: three products for each agent say all about them.

use super::draw::Draw;
use super::memory::{Grid, NONE, StepMemory, TrunkMemory};
use super::scene::{Product, Scene, refused, vector};
use crate::allocator::AllocateError;
use crate::kernels::Kernels;
use crate::kernels::rows::Rows;
use crate::limits;
use crate::math::{all_finite, relu};
use crate::ops::COUNTS;
use crate::ops::proposal_arena::TOGETHER;

/// Writes every proposal's places and counts. The first nodes stand, and what agents add to updates; `updates` is
/// memory for a row of every proposal and agent.
#[inline(always)]
pub(super) fn propose(
    kernels: impl Kernels,
    scene: &Scene<'_>,
    trunk: &TrunkMemory<'_>,
    memory: &mut StepMemory<'_>,
    updates: &mut [f32],
    draw: &mut impl Draw,
) -> Result<(), AllocateError> {
    let tasks = scene.tasks();
    let mut updates =
        Updates { rows: Grid { cells: updates, width: memory.nodes.width }, count: 0 };
    memory.counts.cells.fill(0);
    memory.places.cells.fill(NONE);
    memory.children.cells.fill(NONE);
    memory.update_of.cells.fill(NONE);
    for task in 0..tasks {
        memory.node_of.row_mut(task).fill(task as u16);
    }
    let mut others = [0.0; limits::TASKS];
    for (task, others) in others.iter_mut().enumerate().take(tasks) {
        *others = scene.others_of(task) as f32;
    }
    let last = scene.present_agents().next_back();
    let mut nodes = tasks;
    for agent in scene.present_agents() {
        let pointer = Pointer::new(kernels, scene, trunk.embedded.row(agent), &others)?;
        pointer.meet(kernels, nodes, memory)?;
        choose_all(scene, agent, &pointer, memory, draw)?;
        let new = follow(agent, scene.extent.proposals, memory, nodes);
        if Some(agent) != last {
            updates.compute(kernels, scene, memory, new)?;
            become_new(trunk.from_agents.row(agent), memory, &updates, [nodes, new])?;
            nodes += new;
        }
    }
    Ok(())
}

/// An agent's embedding, and what counts add to its logits.
struct Pointer<'a> {
    embedding: &'a [f32],
    /// What a subtask's agents, one by one, add.
    per_agent: f32,
    /// What the subtask's other entities add, and what is always added.
    always: [f32; limits::TASKS],
    scale: f32,
}

impl<'a> Pointer<'a> {
    #[inline(always)]
    fn new(
        kernels: impl Kernels,
        scene: &Scene<'_>,
        embedding: &'a [f32],
        others: &[f32; limits::TASKS],
    ) -> Result<Self, AllocateError> {
        let step = &scene.network.step;
        let counts = step.counts.of(scene.weights).map_err(refused)?;
        let scale = step.scale.of(scene.weights).map_err(refused)?.first().copied();
        let mut products = [0.0; 4];
        kernels.dots(embedding, Rows::first(counts, embedding.len(), COUNTS), &mut products);
        let [per_other, per_agent, constant, _] = products;
        let always = others.map(|others| others * per_other + constant);
        Ok(Self { embedding, per_agent, always, scale: scale.unwrap_or(1.0) })
    }

    /// The logits of a subtask in some proposals, of which `first` is the first.
    #[inline(always)]
    fn logits(
        &self,
        task: usize,
        first: usize,
        memory: &StepMemory<'_>,
    ) -> Option<[f32; TOGETHER]> {
        let StepMemory { products, node_of, counts, .. } = memory;
        let nodes: &[u16; TOGETHER] = node_of.row(task).get(first..)?.first_chunk()?;
        let counts: &[u16; TOGETHER] = counts.row(task).get(first..)?.first_chunk()?;
        let always = self.always.get(task)?;
        let mut logits = [0.0; TOGETHER];
        for (logit, node) in logits.iter_mut().zip(nodes) {
            *logit = *products.cells.get(usize::from(*node))?;
        }
        for (logit, count) in logits.iter_mut().zip(counts) {
            *logit = (*logit + (f32::from(*count) * self.per_agent + always)) * self.scale;
        }
        Some(logits)
    }

    /// Writes the products of the agent and the first `nodes` nodes.
    #[inline(always)]
    fn meet(
        &self,
        kernels: impl Kernels,
        nodes: usize,
        memory: &mut StepMemory<'_>,
    ) -> Result<(), AllocateError> {
        let width = memory.nodes.width;
        let products = memory.products.cells.chunks_mut(limits::ENTITIES);
        let rows = memory.nodes.cells.chunks((limits::ENTITIES * width).max(1));
        let mut rest = nodes;
        for (rows, products) in rows.zip(products) {
            let count = rest.min(limits::ENTITIES);
            kernels.dots(self.embedding, Rows::first(rows, width, count), products);
            let computed = products.get(..count).ok_or(AllocateError::TooLarge)?;
            if !all_finite(computed) {
                return Err(AllocateError::NonFinite);
            }
            rest -= count;
            if rest == 0 {
                return Ok(());
            }
        }
        Err(AllocateError::TooLarge)
    }
}

/// Lets one agent choose in every proposal.
#[inline(always)]
fn choose_all(
    scene: &Scene<'_>,
    agent: usize,
    pointer: &Pointer<'_>,
    memory: &mut StepMemory<'_>,
    draw: &mut impl Draw,
) -> Result<(), AllocateError> {
    let (tasks, open) = (scene.tasks(), scene.state.open_tasks);
    for first in (0..scene.extent.proposals).step_by(TOGETHER) {
        let mut logits = heapless::Vec::<_, { limits::TASKS }>::new();
        for task in 0..tasks {
            let of_task = pointer.logits(task, first, memory).ok_or(AllocateError::TooLarge)?;
            if !all_finite(&of_task) {
                return Err(AllocateError::NonFinite);
            }
            // There is room for every subtask.
            let _ = logits.push(of_task);
        }
        let proposals = first..scene.extent.proposals.min(first + TOGETHER);
        let choices = draw.draw_together(proposals.clone(), agent, &logits, open);
        for (proposal, task) in proposals.zip(choices) {
            if task >= tasks || open >> task & 1 == 0 {
                return Err(AllocateError::Infeasible);
            }
            memory.places.set(proposal, agent, task as u16);
        }
    }
    Ok(())
}

/// Counts one agent's choices, and moves on to the nodes that they lead to; returns how many of those are new.
#[inline(always)]
fn follow(agent: usize, proposals: usize, memory: &mut StepMemory<'_>, nodes: usize) -> usize {
    let StepMemory { node_of, counts, places, children, parent_of, .. } = memory;
    let mut new = 0;
    for proposal in 0..proposals {
        let task = usize::from(places.get(proposal, agent));
        counts.set(task, proposal, counts.get(task, proposal).saturating_add(1));
        let parent = node_of.get(task, proposal);
        let mut child = children.get(0, usize::from(parent));
        if child == NONE {
            child = (nodes + new) as u16;
            children.set(0, usize::from(parent), child);
            parent_of.set(0, new, parent);
            new += 1;
        }
        node_of.set(task, proposal, child);
    }
    new
}

/// What nodes add to those that become of them, `W_u relu(g)`, in the order in which they are asked for.
struct Updates<'a> {
    rows: Grid<'a, f32>,
    count: usize,
}

impl Updates<'_> {
    /// Computes the updates of the parents of new nodes, unless they are there already.
    #[inline(always)]
    fn compute(
        &mut self,
        kernels: impl Kernels,
        scene: &Scene<'_>,
        memory: &mut StepMemory<'_>,
        new: usize,
    ) -> Result<(), AllocateError> {
        let StepMemory { nodes, parents, update_of, parent_of, .. } = memory;
        let mut count = 0;
        for parent in parent_of.cells.iter().take(new).map(|parent| usize::from(*parent)) {
            if update_of.get(0, parent) != NONE {
                continue;
            }
            update_of.set(0, parent, (self.count + count) as u16);
            for (to, value) in parents.row_mut(count).iter_mut().zip(nodes.row(parent)) {
                *to = relu(*value);
            }
            count += 1;
        }
        let width = self.rows.width;
        let fresh = self.rows.cells.get_mut(self.count.saturating_mul(width)..);
        let fresh = fresh.ok_or(AllocateError::TooLarge)?;
        let product = Product::new(&scene.network.step.from_task, scene.weights, false)?;
        product.behind_relu().rows(kernels, parents, fresh, width, 0..count);
        self.count += count;
        Ok(())
    }
}

/// Computes the nodes that an agent's choices made: `g + W_u [relu(g); relu(h)] + b_u`.
#[inline(always)]
fn become_new(
    from_agent: &[f32],
    memory: &mut StepMemory<'_>,
    updates: &Updates<'_>,
    [nodes, new]: [usize; 2],
) -> Result<(), AllocateError> {
    let StepMemory { nodes: all, update_of, children, parent_of, .. } = memory;
    let width = all.width;
    let split = all.cells.split_at_mut_checked(nodes.saturating_mul(width));
    let (known, fresh) = split.ok_or(AllocateError::TooLarge)?;
    for (to, parent) in fresh.chunks_exact_mut(width.max(1)).zip(parent_of.cells.iter()).take(new) {
        let parent = usize::from(*parent);
        let update = updates.rows.row(usize::from(update_of.get(0, parent)));
        let parts = vector(known, width, parent).iter().zip(update).zip(from_agent);
        for (to, ((parent, update), from_agent)) in to.iter_mut().zip(parts) {
            *to = parent + (update + from_agent);
        }
        // The next agent makes other nodes of them.
        children.set(0, parent, NONE);
    }
    Ok(())
}
