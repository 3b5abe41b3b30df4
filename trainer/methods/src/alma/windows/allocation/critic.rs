//! Values of allocations, and the way back to the critic's weights.
//!
//! Dissertation section 7.2.1 and the public code's allocation critic. What an entity looks like depends
//! on its subtask and on how many work there, not on the rest of the allocation: allocations of one state
//! share these rows. Absent entities are left out.

use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::vectors::{add_scaled, dots};
use sortie_nn::layers::wide::{Work, run_widest};
use sortie_nn::layers::{SparseRows, VisibleLists, attention, linear, relu, sparse_linear};

use super::AllocationShape;
use super::gathers::{gather, scatter_add};
use super::networks::{AllocationCritic, COUNT_SCALE};
use super::rows::{States, team_size};
use super::trunk::NONE;
use crate::alma::windows::NO_TASK;
use crate::sized;

/// Allocations to be valued, with what their rows share.
#[derive(Clone, Debug, Default)]
pub(super) struct CriticInput {
    /// Distinct entities.
    rows: SparseRows,
    /// Those of them that are agents, which query.
    agent_rows: Vec<u32>,
    /// For each query its agent among them.
    query_agents: Vec<u32>,
    /// For each query the rows of its allocation.
    visible: VisibleLists,
    /// Where the queries of each allocation end.
    ends: Vec<usize>,
    /// A
    slots: usize,
    /// The rows of the present state by entity, task and team size, or [`NONE`].
    known: Vec<u32>,
    /// For each row its place among the agents' rows, or [`NONE`].
    agent_of_row: Vec<u32>,
    list: Vec<u32>,
}

impl CriticInput {
    pub(super) fn clear(&mut self) {
        self.rows.clear();
        self.agent_rows.clear();
        self.query_agents.clear();
        self.visible.clear();
        self.ends.clear();
        self.agent_of_row.clear();
    }

    /// Begins with another state: no row is known.
    pub(super) fn begin_state(&mut self, states: &States) {
        self.slots = states.agents;
        let keys = states.entities * (states.tasks + 1) * (states.agents + 1);
        self.known.clear();
        self.known.resize(keys, NONE);
    }

    /// Adds an allocation `[A]` of the state begun last; `columns [T]` are task columns.
    pub(super) fn push(
        &mut self,
        shape: AllocationShape,
        states: &States,
        state: usize,
        allocation: &[u8],
        columns: &[u8],
    ) {
        let present = states.present(state);
        let task_of = |entity: usize| match allocation.get(entity) {
            Some(task) => *task,
            None => states.entity_task(state)[entity],
        };
        self.list.clear();
        for entity in (0..states.entities).filter(|entity| present[*entity]) {
            let task = task_of(entity);
            let size = team_size(allocation, task);
            let task_key = if task == NO_TASK { states.tasks } else { usize::from(task) };
            let key = (entity * (states.tasks + 1) + task_key) * (states.agents + 1) + size;
            if self.known[key] == NONE {
                self.known[key] = self.rows.len() as u32;
                let is_agent = entity < states.agents;
                self.agent_of_row.push(if is_agent { self.agent_rows.len() as u32 } else { NONE });
                if is_agent {
                    self.agent_rows.push(self.known[key]);
                }
                states.copy_features(state, entity, &mut self.rows);
                if let Some(column) = columns.get(usize::from(task)) {
                    let others = states.others(state, task);
                    self.push_task(shape, usize::from(*column), size, others);
                }
                self.rows.end_row();
            }
            self.list.push(self.known[key]);
        }
        for row in &self.list {
            let agent = self.agent_of_row[*row as usize];
            if agent != NONE {
                self.query_agents.push(agent);
                self.list.iter().for_each(|row| self.visible.push(*row as usize));
                self.visible.end_list();
            }
        }
        self.ends.push(self.query_agents.len());
    }

    fn push_task(&mut self, shape: AllocationShape, column: usize, agents: usize, others: usize) {
        self.rows.push(shape.features + column, 1.0);
        let counts = shape.features + shape.columns;
        for (place, count) in [agents, others, 1].into_iter().enumerate() {
            if count > 0 {
                self.rows.push(counts + place, COUNT_SCALE * count as f32);
            }
        }
    }

    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }
}

/// Buffers of one worker: activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct CriticPass {
    /// `[rows, E]`
    embedding: Vec<f32>,
    /// `[agent rows, E]`
    agents: Vec<f32>,
    agent_queries: Vec<f32>,
    queries: Vec<f32>,
    keys_values: Vec<f32>,
    weights: Vec<f32>,
    attended: Vec<f32>,
    /// `[queries, E]`: what the agents have seen, rectified.
    seen: Vec<f32>,
    /// `[allocations, E]`: the mean of that over all agent slots.
    pooled: Vec<f32>,
    values: Vec<f32>,
    d_seen: Vec<f32>,
    d_attended: Vec<f32>,
    d_queries: Vec<f32>,
    d_agent_queries: Vec<f32>,
    d_agents: Vec<f32>,
    d_keys_values: Vec<f32>,
    d_scores: Vec<f32>,
    d_embedding: Vec<f32>,
    /// Floating-point operations of matrix products and attention.
    pub(super) operations: u64,
}

impl CriticPass {
    /// Computes the value of every allocation, before the head of PopArt.
    pub(super) fn forward(&mut self, critic: &AllocationCritic, input: &CriticInput) -> &[f32] {
        let (shape, view) = (critic.shape(), critic.parts());
        let width = shape.width;
        let (rows, agents) = (input.rows.len(), input.agent_rows.len());
        let queries = input.query_agents.len();

        let embedding = sized(&mut self.embedding, rows * width);
        sparse_linear::forward(&input.rows, view.embedding, view.embedding_bias, embedding);
        relu::forward(embedding);
        let own = sized(&mut self.agents, agents * width);
        gather(width, embedding, &input.agent_rows, own);
        let agent_queries = sized(&mut self.agent_queries, agents * width);
        linear::forward_without_bias(shape.square(), own, view.queries, agent_queries);
        let query = sized(&mut self.queries, queries * width);
        gather(width, agent_queries, &input.query_agents, query);
        let keys_values = sized(&mut self.keys_values, 2 * rows * width);
        linear::forward_without_bias(shape.keys_values(), embedding, view.keys_values, keys_values);

        let weights = sized(&mut self.weights, input.visible.pairs() * shape.heads);
        let attended = sized(&mut self.attended, queries * width);
        attention::forward(
            shape.attention(),
            &input.visible,
            query,
            keys_values,
            weights,
            attended,
        );
        let seen = sized(&mut self.seen, queries * width);
        linear::forward_rectified(shape.square(), attended, view.out, view.out_bias, seen);
        let pooled = sized(&mut self.pooled, input.len() * width);
        let values = sized(&mut self.values, input.len());
        let (weight, bias) = (view.value, view.value_bias[0]);
        run_widest(Pool { width, input, seen, weight, bias, pooled, values });
        self.operations += (2 * products(shape, input)) as u64;
        values
    }

    /// Adds to `gradient` (all parameters) the gradient of a loss whose slopes by the values of the last
    /// forward pass are `d_values [allocations]`.
    pub(super) fn backward(
        &mut self,
        critic: &AllocationCritic,
        input: &CriticInput,
        d_values: &[f32],
        gradient: &mut [f32],
    ) {
        let (shape, view) = (critic.shape(), critic.parts());
        let gradient = AllocationCritic::parts_of(shape, gradient);
        let width = shape.width;
        let (rows, agents) = (input.rows.len(), input.agent_rows.len());
        let queries = input.query_agents.len();
        let square = shape.square();

        let d_seen = sized(&mut self.d_seen, queries * width);
        let share = 1.0 / input.slots as f32;
        let mut start = 0;
        for ((end, d_value), pooled) in
            input.ends.iter().zip(d_values).zip(self.pooled.chunks_exact(width))
        {
            add_scaled(gradient.value, *d_value, pooled);
            gradient.value_bias[0] += d_value;
            for d_seen in d_seen[start * width..end * width].chunks_exact_mut(width) {
                d_seen.fill(0.0);
                add_scaled(d_seen, share * d_value, view.value);
            }
            start = *end;
        }
        relu::backward(&self.seen[..queries * width], d_seen);
        let attended = &self.attended[..queries * width];
        linear::backward_weight(square, attended, d_seen, gradient.out);
        linear::backward_bias(d_seen, gradient.out_bias);
        let d_attended = sized(&mut self.d_attended, queries * width);
        linear::backward_input(square, d_seen, view.out, Store::Replace, d_attended);

        let pass = attention::Backward {
            queries: &self.queries[..queries * width],
            keys_values: &self.keys_values[..2 * rows * width],
            weights: &self.weights,
            d_output: d_attended,
            d_scores: sized(&mut self.d_scores, rows * shape.heads),
            d_queries: sized(&mut self.d_queries, queries * width),
            d_keys_values: sized(&mut self.d_keys_values, 2 * rows * width),
        };
        attention::backward(shape.attention(), &input.visible, pass);

        let own = &self.agents[..agents * width];
        let d_agent_queries = sized(&mut self.d_agent_queries, agents * width);
        d_agent_queries.fill(0.0);
        scatter_add(width, &self.d_queries, &input.query_agents, d_agent_queries);
        linear::backward_weight(square, own, d_agent_queries, gradient.queries);
        let d_agents = sized(&mut self.d_agents, agents * width);
        linear::backward_input(square, d_agent_queries, view.queries, Store::Replace, d_agents);

        let embedding = &self.embedding[..rows * width];
        let d_keys_values = &self.d_keys_values[..2 * rows * width];
        let d_embedding = sized(&mut self.d_embedding, rows * width);
        linear::backward_weight(
            shape.keys_values(),
            embedding,
            d_keys_values,
            gradient.keys_values,
        );
        let weights = view.keys_values;
        linear::backward_input(
            shape.keys_values(),
            d_keys_values,
            weights,
            Store::Replace,
            d_embedding,
        );
        scatter_add(width, d_agents, &input.agent_rows, d_embedding);
        relu::backward(embedding, d_embedding);
        let bias = gradient.embedding_bias;
        sparse_linear::backward(&input.rows, d_embedding, gradient.embedding, bias);
        self.operations += (4 * products(shape, input)) as u64;
    }
}

/// Multiplications of matrix products and attention in a forward pass.
fn products(shape: AllocationShape, input: &CriticInput) -> usize {
    let width = shape.width;
    let (rows, agents) = (input.rows.len(), input.agent_rows.len());
    (2 * rows + agents + input.query_agents.len()) * width * width
        + 2 * input.visible.pairs() * width
}

/// Means over agents, and their product with the last layer's weight.
struct Pool<'a> {
    width: usize,
    input: &'a CriticInput,
    seen: &'a [f32],
    weight: &'a [f32],
    bias: f32,
    pooled: &'a mut [f32],
    values: &'a mut [f32],
}

impl Work for Pool<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.width;
        let share = 1.0 / self.input.slots as f32;
        let mut start = 0;
        for ((end, pooled), value) in
            self.input.ends.iter().zip(self.pooled.chunks_exact_mut(width)).zip(self.values)
        {
            pooled.fill(0.0);
            for seen in self.seen[start * width..*end * width].chunks_exact(width) {
                add_scaled(pooled, share, seen);
            }
            let mut dot = [0.0];
            dots(pooled, self.weight, &mut dot);
            *value = dot[0] + self.bias;
            start = *end;
        }
    }
}
