//! What the proposals of a state share: its agents, and one vector for every open subtask.
//!
//! The vector of a subtask is the sum of what its entities attend to among themselves; an entity alone
//! attends to itself with weight 1, so that its queries and keys need not be computed. Subtasks that
//! are not open are never chosen, and absent entities count for nothing: both are left out.

use std::ops::Range;

use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use sortie_nn::layers::vectors::add_scaled;
use sortie_nn::layers::{SparseRows, VisibleLists, attention, linear, relu, sparse_linear};

use super::AllocationShape;
use super::gathers::{add_rectified, gather, scatter_add};
use super::networks::{COUNT_SCALE, PolicyParts};
use super::rows::States;
use crate::alma::windows::NO_TASK;
use crate::sized;

/// Nothing stands here.
pub(super) const NONE: u32 = u32::MAX;

/// Who and what a block of states is about. States are counted from the block's first.
#[derive(Clone, Debug, Default)]
pub(super) struct Block {
    pub(super) states: Range<usize>,
    /// A
    pub(super) agents: usize,
    /// T
    pub(super) tasks: usize,
    /// How many agents each state allocates: its present ones, or none where no subtask is open.
    pub(super) levels: Vec<usize>,
    /// `[states, A]`: the agents that are allocated, one behind the other.
    pub(super) slots: Vec<u8>,
    /// `[states, A]`: their rows.
    pub(super) agent_rows: Vec<u32>,
    /// Rows of agents; those that others follow stand before the last ones of their states.
    pub(super) agent_count: usize,
    /// Rows of agents that others follow.
    pub(super) followed: usize,
    /// `[states, T]`: the number of each open subtask among all of the block, or [`NONE`].
    pub(super) open: Vec<u32>,
    /// The agents, then the other entities.
    rows: SparseRows,
    /// For each other entity the number of its subtask.
    entity_open: Vec<u32>,
    /// For each other entity those of the same subtask.
    same_task: VisibleLists,
    /// Whether no subtask has several present entities.
    alone: bool,
    /// For each open subtask its entities, present or not, times [`COUNT_SCALE`].
    pub(super) others: Vec<f32>,
    /// For each open subtask its present entities.
    members: Vec<f32>,
}

impl Block {
    /// Lists the rows of some states; `columns [T]` are the task columns.
    pub(super) fn fill(
        &mut self,
        shape: AllocationShape,
        states: &States,
        range: Range<usize>,
        columns: &[u8],
    ) {
        self.clear(states, range.clone());
        for state in range.clone() {
            self.list_agents(states, state);
        }
        for (followed, local) in
            [true, false].into_iter().flat_map(|f| (0..range.len()).map(move |local| (f, local)))
        {
            let levels = self.levels[local];
            let places = if followed { 0..levels.max(1) - 1 } else { levels.max(1) - 1..levels };
            for place in places {
                let index = local * self.agents + place;
                let (state, agent) = (range.start + local, usize::from(self.slots[index]));
                self.agent_rows[index] = self.rows.len() as u32;
                let task = states.last_allocation(state)[agent];
                self.push_row(shape, states, (state, agent), columns.get(usize::from(task)));
            }
            if followed && local + 1 == range.len() {
                self.followed = self.rows.len();
            }
        }
        self.agent_count = self.rows.len();
        for state in range {
            self.list_others(shape, states, state, columns);
        }
    }

    fn clear(&mut self, states: &States, range: Range<usize>) {
        self.agents = states.agents;
        self.tasks = states.tasks;
        self.levels.clear();
        self.slots.clear();
        self.agent_rows.clear();
        self.agent_rows.resize(range.len() * states.agents, NONE);
        self.states = range;
        self.open.clear();
        self.rows.clear();
        self.entity_open.clear();
        self.same_task.clear();
        self.alone = true;
        self.others.clear();
        self.members.clear();
        (self.followed, self.agent_count) = (0, 0);
    }

    fn list_agents(&mut self, states: &States, state: usize) {
        let any_open = states.open(state).contains(&true);
        let present = (0..).zip(&states.present(state)[..self.agents]);
        let start = self.slots.len();
        self.slots.extend(present.filter(|(_, here)| **here && any_open).map(|(agent, _)| agent));
        self.levels.push(self.slots.len() - start);
        self.slots.resize(start + self.agents, 0);
    }

    fn list_others(
        &mut self,
        shape: AllocationShape,
        states: &States,
        state: usize,
        columns: &[u8],
    ) {
        let start = self.open.len();
        for (task, open) in (0..).zip(states.open(state)) {
            self.open.push(if *open { self.others.len() as u32 } else { NONE });
            if *open {
                self.others.push(COUNT_SCALE * states.others(state, task) as f32);
                self.members.push(0.0);
            }
        }
        let open = self.open[start..].to_vec();
        let first = self.entity_open.len();
        for entity in self.agents..states.entities {
            let task = states.entity_task(state)[entity];
            if !states.present(state)[entity] || task == NO_TASK {
                continue;
            }
            let number = open[usize::from(task)];
            if number != NONE {
                self.entity_open.push(number);
                self.members[number as usize] += 1.0;
                self.alone &= self.members[number as usize] < 2.0;
                self.push_row(shape, states, (state, entity), columns.get(usize::from(task)));
            }
        }
        for entity in first..self.entity_open.len() {
            let number = self.entity_open[entity];
            let same = (first..self.entity_open.len()).filter(|e| self.entity_open[*e] == number);
            same.for_each(|row| self.same_task.push(row));
            self.same_task.end_list();
        }
    }

    fn push_row(
        &mut self,
        shape: AllocationShape,
        states: &States,
        (state, entity): (usize, usize),
        column: Option<&u8>,
    ) {
        states.copy_features(state, entity, &mut self.rows);
        if let Some(column) = column {
            self.rows.push(shape.features + usize::from(*column), 1.0);
        }
        self.rows.end_row();
    }

    pub(super) fn open_count(&self) -> usize {
        self.others.len()
    }

    pub(super) fn len(&self) -> usize {
        self.levels.len()
    }
}

/// Buffers of one worker: activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct Trunk {
    /// Agents as they are embedded, and the other entities rectified, `[rows, E]`.
    embedding: Vec<f32>,
    /// Agents that others follow, rectified.
    rectified: Vec<f32>,
    /// `[followed agents, E]`: what an agent adds to the vector of its subtask.
    pub(super) updates: Vec<f32>,
    queries: Vec<f32>,
    keys_values: Vec<f32>,
    weights: Vec<f32>,
    attended: Vec<f32>,
    /// `[open subtasks, E]`: the sums of what their entities attend to.
    sums: Vec<f32>,
    pub(super) d_embedding: Vec<f32>,
    pub(super) d_updates: Vec<f32>,
    d_rectified: Vec<f32>,
    d_sums: Vec<f32>,
    d_attended: Vec<f32>,
    d_queries: Vec<f32>,
    d_keys_values: Vec<f32>,
    d_scores: Vec<f32>,
    /// Floating-point operations of the matrix products.
    pub(super) operations: u64,
}

impl Trunk {
    /// Embeds the agents and computes the vectors `tasks [open subtasks, E]`.
    pub(super) fn forward(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        block: &Block,
        tasks: &mut [f32],
    ) {
        let width = shape.width;
        let embedding = sized(&mut self.embedding, block.rows.len() * width);
        sparse_linear::forward(&block.rows, view.embedding, view.embedding_bias, embedding);
        let (agents, others) = embedding.split_at_mut(block.agent_count * width);
        relu::forward(others);

        let count = block.entity_open.len();
        let attended = sized(&mut self.attended, count * width);
        if block.alone {
            let values = &view.keys_values[width * width..];
            linear::forward_without_bias(shape.square(), others, values, attended);
        } else {
            let queries = sized(&mut self.queries, count * width);
            linear::forward_without_bias(shape.square(), others, view.queries, queries);
            let keys_values = sized(&mut self.keys_values, 2 * count * width);
            linear::forward_without_bias(
                shape.keys_values(),
                others,
                view.keys_values,
                keys_values,
            );
            let weights = sized(&mut self.weights, block.same_task.pairs() * shape.heads);
            let lists = &block.same_task;
            attention::forward(shape.attention(), lists, queries, keys_values, weights, attended);
        }
        let sums = sized(&mut self.sums, block.open_count() * width);
        sums.fill(0.0);
        scatter_add(width, attended, &block.entity_open, sums);
        linear::forward_without_bias(shape.square(), sums, view.out, tasks);
        for (task, members) in tasks.chunks_exact_mut(width).zip(&block.members) {
            add_scaled(task, *members, view.out_bias);
        }

        let rectified = sized(&mut self.rectified, block.followed * width);
        rectified.copy_from_slice(&agents[..block.followed * width]);
        relu::forward(rectified);
        let updates = sized(&mut self.updates, block.followed * width);
        let bias = view.update_bias;
        linear::forward(shape.square(), rectified, view.update_agent, bias, updates);

        let projections = if block.alone { 1 } else { 3 };
        let products = count * projections + block.open_count() + block.followed;
        self.operations += (2 * products * width * width) as u64;
    }

    /// The agents `[agents, E]`.
    pub(super) fn agents(&self, shape: AllocationShape, block: &Block) -> &[f32] {
        &self.embedding[..block.agent_count * shape.width]
    }

    /// Makes room for the gradients of agents and updates, and zeroes it.
    pub(super) fn begin_backward(&mut self, shape: AllocationShape, block: &Block) {
        sized(&mut self.d_embedding, block.rows.len() * shape.width);
        self.d_embedding[..block.agent_count * shape.width].fill(0.0);
        sized(&mut self.d_updates, block.followed * shape.width).fill(0.0);
    }

    /// The agents and, to be added to, their gradient.
    pub(super) fn agents_and_gradient(
        &mut self,
        shape: AllocationShape,
        block: &Block,
    ) -> (&[f32], &mut [f32]) {
        let length = block.agent_count * shape.width;
        (&self.embedding[..length], &mut self.d_embedding[..length])
    }

    /// Adds the gradients of a loss whose slopes by the vectors of the subtasks are `d_tasks`, and by
    /// agents and updates what was added to theirs since [`begin_backward`](Self::begin_backward).
    pub(super) fn backward(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        block: &Block,
        d_tasks: &[f32],
        gradient: &mut PolicyParts<&mut [f32]>,
    ) {
        let width = shape.width;
        let square = shape.square();
        let followed = block.followed * width;
        let (rectified, d_updates) = (&self.rectified[..followed], &self.d_updates[..followed]);
        linear::backward_weight(square, rectified, d_updates, gradient.update_agent);
        linear::backward_bias(d_updates, gradient.update_bias);
        let d_rectified = sized(&mut self.d_rectified, followed);
        linear::backward_input(square, d_updates, view.update_agent, Store::Replace, d_rectified);
        add_rectified(rectified, d_rectified, &mut self.d_embedding[..followed]);

        let open = block.open_count() * width;
        linear::backward_weight(square, &self.sums[..open], d_tasks, gradient.out);
        for (d_task, members) in d_tasks.chunks_exact(width).zip(&block.members) {
            add_scaled(gradient.out_bias, *members, d_task);
        }
        let d_sums = sized(&mut self.d_sums, open);
        linear::backward_input(square, d_tasks, view.out, Store::Replace, d_sums);
        self.backward_entities(shape, view, block, gradient);
        let d_embedding = &self.d_embedding[..block.rows.len() * width];
        let bias = &mut *gradient.embedding_bias;
        sparse_linear::backward(&block.rows, d_embedding, gradient.embedding, bias);

        let projections = if block.alone { 1 } else { 3 };
        let products = block.entity_open.len() * projections + block.open_count() + block.followed;
        self.operations += (4 * products * width * width) as u64;
    }

    /// Goes back through the attention of the other entities.
    fn backward_entities(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        block: &Block,
        gradient: &mut PolicyParts<&mut [f32]>,
    ) {
        let width = shape.width;
        let (start, end) = (block.agent_count * width, block.rows.len() * width);
        let count = block.entity_open.len();
        let d_attended = sized(&mut self.d_attended, count * width);
        gather(width, &self.d_sums, &block.entity_open, d_attended);
        let (x, d_x) = (&self.embedding[start..end], &mut self.d_embedding[start..end]);
        if block.alone {
            let values = width * width..;
            let d_values = &mut gradient.keys_values[values.clone()];
            linear::backward_weight(shape.square(), x, d_attended, d_values);
            let values = &view.keys_values[values];
            linear::backward_input(shape.square(), d_attended, values, Store::Replace, d_x);
        } else {
            let pass = attention::Backward {
                queries: &self.queries,
                keys_values: &self.keys_values,
                weights: &self.weights,
                d_output: d_attended,
                d_scores: sized(&mut self.d_scores, count * shape.heads),
                d_queries: sized(&mut self.d_queries, count * width),
                d_keys_values: sized(&mut self.d_keys_values, 2 * count * width),
            };
            attention::backward(shape.attention(), &block.same_task, pass);
            let d_queries = &self.d_queries[..count * width];
            let d_keys_values = &self.d_keys_values[..2 * count * width];
            linear::backward_weight(shape.square(), x, d_queries, gradient.queries);
            linear::backward_weight(shape.keys_values(), x, d_keys_values, gradient.keys_values);
            linear::backward_input(shape.square(), d_queries, view.queries, Store::Replace, d_x);
            let weights = view.keys_values;
            linear::backward_input(shape.keys_values(), d_keys_values, weights, Store::Add, d_x);
        }
        relu::backward(x, d_x);
    }
}

/// Writes the dot products of each row and the three count vectors, `[rows, 3]`.
pub(super) fn times_counts(width: usize, rows: &[f32], counts: &[f32], out: &mut [f32]) {
    multiply(
        MatrixMut::new(out, rows.len() / width, 3),
        Store::Replace,
        Matrix::new(rows, rows.len() / width, width),
        Matrix::new(counts, 3, width).transposed(),
    );
}
