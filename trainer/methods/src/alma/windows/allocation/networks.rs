//! The allocation networks: their layers, and all parameters in one vector each.
//!
//! Features, task and counts of an entity meet in one sum, so they are rows of one embedding here. It is
//! stored `[in, E]` because its inputs are sparse; all other matrices are `[out, in]`.

use std::ops::Range;

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::layers::{SparseRows, VisibleLists};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Tape, Var};

use super::AllocationShape;
use super::rows::{COUNT_SCALE, Shown, States, team_size};
use super::tree::NONE;
use crate::alma::agents::stacked;
use crate::alma::windows::NO_TASK;
use crate::alma::windows::popart::PopArt;

/// Adds a tensor `[rows, columns]`, drawn uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
fn drawn(
    p: &mut Parameters,
    name: &str,
    sizes: [usize; 2],
    inputs: usize,
    random: &mut Generator,
) -> usize {
    p.tensor(name, &sizes, 1.0 / (inputs as f32).sqrt(), random)
}

/// The layers of a critic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CriticLayers {
    heads: usize,
    /// `[d + T + 3, E]`: features; task columns; the counts of agents and of other entities and 1, these
    /// three times [`COUNT_SCALE`].
    embedding: Linear,
    queries: Linear,
    keys_values: Linear,
    out: Linear,
    pub(super) value: Linear,
    /// That of PopArt.
    head: Linear,
}

impl CriticLayers {
    fn new(shape: AllocationShape, p: &mut Parameters, random: &mut Generator) -> Self {
        let AllocationShape { features, columns, width, heads } = shape;
        let weight = drawn(p, "entity.weight", [features, width], features, random);
        drawn(p, "task.weight", [columns, width], columns, random);
        drawn(p, "count.weight", [2, width], 2, random);
        drawn(p, "count.bias", [1, width], 2, random);
        let bias = Some(drawn(p, "entity.bias", [1, width], features, random));
        let rows = LinearShape { input: features + columns + 3, output: width };
        let [queries, keys_values] = stacked(p, "attention.in", (width, [1, 2]), random);
        let (out, value) =
            (p.linear("attention.out", width, width, random), p.linear("value", width, 1, random));
        // At first it changes nothing.
        let head = p.norm("head", 1).start;
        let one = LinearShape { input: 1, output: 1 };
        Self {
            heads,
            embedding: Linear { shape: rows, weight, bias },
            queries,
            keys_values,
            out,
            value,
            head: Linear { shape: one, weight: head, bias: Some(head + 1) },
        }
    }

    /// The value of every allocation, `[allocations, 1]`, before the head of PopArt.
    pub(super) fn values(self, t: &mut Pass<'_>, input: &CriticInput) -> Var {
        let entities = t.sparse_linear_rectified(&input.rows, self.embedding);
        // What an agent asks in one allocation it asks in all that share its row.
        let agents = t.gather(entities, &input.agent_rows);
        let queries = t.linear(agents, self.queries);
        let queries = t.gather(queries, &input.query_agents);
        let keys_values = t.linear(entities, self.keys_values);
        let attended = t.attention(queries, keys_values, &input.visible, self.heads);
        let seen = t.linear_rectified(attended, self.out);
        let sums = t.scatter(seen, &input.allocation_of, input.allocations);
        let pooled = t.scale(sums, 1.0 / input.slots as f32);
        t.linear(pooled, self.value)
    }

    /// Where weight and bias of the head stand.
    pub(super) fn head_range(self) -> Range<usize> {
        self.head.weight..self.head.weight + 2
    }

    /// Values in normalised units.
    pub(super) fn head(self, t: &mut Pass<'_>, values: Var) -> Var {
        t.linear(values, self.head)
    }
}

/// The layers of a policy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PolicyLayers {
    pub(super) heads: usize,
    /// `[d + T, E]`: features; task columns.
    pub(super) embedding: Linear,
    pub(super) queries: Linear,
    pub(super) keys_values: Linear,
    pub(super) out: Linear,
    /// `[3, E]`: other entities, agents, 1; only the counts are times [`COUNT_SCALE`].
    pub(super) count: usize,
    /// The half of the update that sees the task.
    pub(super) update_task: Linear,
    /// The half of the update that sees the agent.
    pub(super) update_agent: Linear,
}

impl PolicyLayers {
    fn new(shape: AllocationShape, p: &mut Parameters, random: &mut Generator) -> Self {
        let AllocationShape { features, columns, width, heads } = shape;
        let weight = drawn(p, "entity.weight", [features, width], features, random);
        drawn(p, "task.weight", [columns, width], columns, random);
        let bias = Some(drawn(p, "entity.bias", [1, width], features, random));
        let rows = LinearShape { input: features + columns, output: width };
        let [queries, keys_values] = stacked(p, "attention.in", (width, [1, 2]), random);
        let out = p.linear("attention.out", width, width, random);
        let count = drawn(p, "count.weight", [2, width], 2, random);
        drawn(p, "count.bias", [1, width], 2, random);
        let square = LinearShape { input: width, output: width };
        let [task, agent] = ["update.task.weight", "update.agent.weight"]
            .map(|name| drawn(p, name, [width; 2], 2 * width, random));
        let update_bias = Some(drawn(p, "update.agent.bias", [1, width], 2 * width, random));
        Self {
            heads,
            embedding: Linear { shape: rows, weight, bias },
            queries,
            keys_values,
            out,
            count,
            update_task: Linear { shape: square, weight: task, bias: None },
            update_agent: Linear { shape: square, weight: agent, bias: update_bias },
        }
    }
}

/// Allocations to be valued, with what their rows share (dissertation section 7.2.1 and the public code's allocation critic).
///
/// What an entity looks like depends on its subtask and on how many work there, not on the rest of the allocation:
/// allocations of one state share these rows. Absent entities are left out.
#[derive(Clone, Debug, Default)]
pub(super) struct CriticInput {
    /// Distinct entities.
    pub(super) rows: SparseRows,
    /// Those of them that are agents, which query.
    pub(super) agent_rows: Vec<u32>,
    /// For each query its agent among them.
    pub(super) query_agents: Vec<u32>,
    /// For each query the rows of its allocation.
    pub(super) visible: VisibleLists,
    /// For each query its allocation.
    pub(super) allocation_of: Vec<u32>,
    pub(super) allocations: usize,
    /// A
    pub(super) slots: usize,
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
        self.allocation_of.clear();
        self.allocations = 0;
        self.agent_of_row.clear();
    }

    /// Begins with another state: no row is known.
    pub(super) fn begin_state(&mut self, states: &States) {
        self.slots = states.agents;
        let keys = states.entities * (states.tasks + 1) * (states.agents + 1);
        self.known.clear();
        self.known.resize(keys, NONE);
    }

    /// Adds an allocation `[A]` of the state begun last.
    pub(super) fn push(&mut self, shown: Shown<'_>, state: usize, allocation: &[u8]) {
        let states = shown.states;
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
                if shown.begin_row(state, entity, task, &mut self.rows) {
                    let first = shown.shape.features + shown.shape.columns;
                    let counts = [size, states.others(state, task), 1];
                    for (place, count) in counts.into_iter().enumerate().filter(|it| it.1 > 0) {
                        self.rows.push(first + place, COUNT_SCALE * count as f32);
                    }
                }
                self.rows.end_row();
            }
            self.list.push(self.known[key]);
        }
        for row in &self.list {
            let agent = self.agent_of_row[*row as usize];
            if agent != NONE {
                self.query_agents.push(agent);
                self.allocation_of.push(self.allocations as u32);
                self.list.iter().for_each(|row| self.visible.push(*row as usize));
                self.visible.end_list();
            }
        }
        self.allocations += 1;
    }
}

/// The critic `Q(s, b)` of allocations.
#[derive(Clone, Debug, PartialEq)]
pub struct AllocationCritic {
    /// The sizes.
    pub shape: AllocationShape,
    pub(super) layers: CriticLayers,
    /// All parameters: `entity.weight [d, E]`, `task.weight [T, E]`, `count.weight [2, E]` (agents of the task, its other
    /// entities; with its bias times 0.2), `count.bias`, `entity.bias`, `attention.in.weight [3 E, E]` (queries, keys,
    /// values), `attention.out`, `value`, and `head`, those of PopArt.
    pub parameters: Parameters,
    /// Statistics of the targets.
    pub popart: PopArt,
}

impl AllocationCritic {
    /// Draws weights and biases; the head of PopArt begins as the identity.
    pub fn initialise(shape: AllocationShape, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let layers = CriticLayers::new(shape, &mut parameters, random);
        Self { shape, layers, parameters, popart: PopArt::default() }
    }

    /// Values allocations `[K, A]` of some states, `[allocations, 1]`, before PopArt's head; `columns [T]` are task columns.
    pub(super) fn value<'t>(
        &'t self,
        tape: &'t mut Tape,
        input: &mut CriticInput,
        (states, columns): (&States, &[u8]),
        allocations: impl Iterator<Item = (usize, impl AsRef<[u8]>)>,
    ) -> (Pass<'t>, Var) {
        input.clear();
        let shown = Shown { shape: self.shape, states, columns };
        for (state, own) in allocations {
            input.begin_state(states);
            for allocation in own.as_ref().chunks_exact(states.agents) {
                input.push(shown, state, allocation);
            }
        }
        let mut t = tape.begin(&self.parameters.values);
        let values = self.layers.values(&mut t, input);
        (t, values)
    }

    /// The value of an output of the network before its PopArt head, in real units.
    pub fn real(&self, raw: f32) -> f64 {
        let [weight, bias] = self.head();
        self.popart.denormalise(f64::from(weight * raw + bias))
    }

    /// 1 where [`Self::real`] rises with the output, -1 where it falls.
    ///
    /// Nothing keeps the learned weight of the head positive, and deployment ranks what comes behind it.
    pub(super) fn rises(&self) -> f32 {
        let [weight, _] = self.head();
        f32::from(i8::from(weight > 0.0) - i8::from(weight < 0.0))
    }

    /// Weight and bias of the PopArt head.
    pub fn head(&self) -> [f32; 2] {
        let head = self.layers.head.weight;
        [self.parameters.values[head], self.parameters.values[head + 1]]
    }
}

/// The policy `f(b | s)` that proposes allocations.
#[derive(Clone, Debug, PartialEq)]
pub struct AllocationPolicy {
    /// The sizes.
    pub shape: AllocationShape,
    pub(super) layers: PolicyLayers,
    /// All parameters: `entity.weight [d, E]`, `task.weight [T, E]`, `entity.bias`, `attention.in.weight [3 E, E]` (queries,
    /// keys, values), `attention.out`, `count.weight [2, E]` (other entities of the task, its agents; both counts times 0.2),
    /// `count.bias`, not scaled, and both halves of the update, `update.task.weight [E, E]` and `update.agent`.
    pub parameters: Parameters,
}

impl AllocationPolicy {
    /// Draws weights and biases.
    pub fn initialise(shape: AllocationShape, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let layers = PolicyLayers::new(shape, &mut parameters, random);
        Self { shape, layers, parameters }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_learn::random::{Purpose, generator};

    #[test]
    fn the_published_sizes_have_the_published_number_of_parameters() {
        let shape = AllocationShape { features: 58, columns: 6, width: 128, heads: 4 };
        let mut random = generator(1, Purpose::Weights, 0);
        let critic = AllocationCritic::initialise(shape, &mut random);
        let policy = AllocationPolicy::initialise(shape, &mut random);
        let counts = [critic.parameters, policy.parameters].map(|all| all.values.len());
        assert_eq!(counts, [74_499, 107_264]);
    }
}
