//! The allocation networks: all parameters in one flat vector each, and their layers on a tape.
//!
//! Features, task and counts of an entity meet in one sum, so they are rows of one embedding here. It is
//! stored `[in, E]` because its inputs are sparse; all other matrices are `[out, in]`.

use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Pass, Places, Var};

use super::critic::CriticInput;
use super::{AllocationShape, CriticWeights, PolicyWeights};
use crate::alma::agents::{drawn, transpose};
use crate::alma::windows::popart::PopArt;

/// Numbers of every tensor in the order of the flat vector, and the inputs of its layer.
pub(super) type Tensors<const COUNT: usize> = [(usize, usize); COUNT];

/// The layers of a critic, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct CriticLayers {
    heads: usize,
    /// `[d + T + 3, E]`: features; task columns; the counts of agents and of other entities and 1, these
    /// three times [`COUNT_SCALE`](super::rows::COUNT_SCALE).
    embedding: Linear,
    queries: Linear,
    keys_values: Linear,
    out: Linear,
    value: Linear,
    /// That of PopArt.
    head: Linear,
}

impl CriticLayers {
    pub(super) fn of(shape: AllocationShape, places: &mut Places) -> Self {
        let AllocationShape { features, columns, width, heads } = shape;
        Self {
            heads,
            embedding: places.linear(features + columns + 3, width),
            queries: places.projection(width, width),
            keys_values: places.projection(width, 2 * width),
            out: places.linear(width, width),
            value: places.linear(width, 1),
            head: places.linear(1, 1),
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

    /// Values in normalised units.
    pub(super) fn head(self, t: &mut Pass<'_>, values: Var) -> Var {
        t.linear(values, self.head)
    }
}

/// The layers of a policy, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct PolicyLayers {
    pub(super) heads: usize,
    /// `[d + T, E]`: features; task columns.
    pub(super) embedding: Linear,
    pub(super) queries: Linear,
    pub(super) keys_values: Linear,
    pub(super) out: Linear,
    /// `[3, E]`: other entities, agents, 1; only the counts are times [`COUNT_SCALE`](super::rows::COUNT_SCALE).
    pub(super) count: usize,
    /// The half of the update that sees the task.
    pub(super) update_task: Linear,
    /// The half of the update that sees the agent.
    pub(super) update_agent: Linear,
}

impl PolicyLayers {
    pub(super) fn of(shape: AllocationShape, places: &mut Places) -> Self {
        let AllocationShape { features, columns, width, heads } = shape;
        Self {
            heads,
            embedding: places.linear(features + columns, width),
            queries: places.projection(width, width),
            keys_values: places.projection(width, 2 * width),
            out: places.linear(width, width),
            count: places.numbers(3 * width),
            update_task: places.projection(width, width),
            update_agent: places.linear(width, width),
        }
    }
}

/// The critic `Q(s, b)` of allocations.
#[derive(Clone, Debug, PartialEq)]
pub struct AllocationCritic {
    shape: AllocationShape,
    parameters: Vec<f32>,
    /// Statistics of the targets.
    pub popart: PopArt,
}

impl AllocationCritic {
    /// Features, task columns, counts and their bias, bias of the features; queries, keys and values; the projection
    /// behind the attention; the value; the head of PopArt.
    pub(super) fn tensors(shape: AllocationShape) -> Tensors<12> {
        let AllocationShape { features, columns, width, .. } = shape;
        let square = width * width;
        [
            (features * width, features),
            (columns * width, columns),
            (2 * width, 2),
            (width, 2),
            (width, features),
            (3 * square, width),
            (square, width),
            (width, width),
            (width, width),
            (1, width),
            (1, 1),
            (1, 1),
        ]
    }

    /// Number of parameters of a shape.
    pub fn count(shape: AllocationShape) -> usize {
        count(Self::tensors(shape))
    }

    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does; the head of
    /// PopArt begins as the identity.
    pub fn initialise(shape: AllocationShape, generator: &mut Generator) -> Self {
        let mut parameters = drawn(Self::tensors(shape), generator);
        let head = parameters.len() - 2;
        parameters[head..].copy_from_slice(&[1.0, 0.0]);
        Self { shape, parameters, popart: PopArt::default() }
    }

    /// A critic with these parameters, or `None` where their number does not fit the shape.
    pub fn from_parameters(
        shape: AllocationShape,
        parameters: Vec<f32>,
        popart: PopArt,
    ) -> Option<Self> {
        let fits = parameters.len() == Self::count(shape);
        fits.then_some(Self { shape, parameters, popart })
    }

    /// The critic with these tensors, or `None` where one does not fit the shape.
    pub fn from_weights(weights: &CriticWeights) -> Option<Self> {
        let shape = weights.shape;
        let AllocationShape { features, columns, width, .. } = shape;
        let parts = [
            transposed(&weights.entity_weight, width, features)?,
            transposed(&weights.task_weight, width, columns)?,
            transposed(&weights.count_weight, width, 2)?,
            weights.count_bias.clone(),
            weights.entity_bias.clone(),
            weights.attention_in_weight.clone(),
            weights.attention_out_weight.clone(),
            weights.attention_out_bias.clone(),
            weights.value_weight.clone(),
            weights.value_bias.clone(),
            vec![weights.popart_weight],
            vec![weights.popart_bias],
        ];
        let (mean, deviation) = (f64::from(weights.mean), f64::from(weights.deviation));
        let popart = PopArt { mean, variance: deviation * deviation, started: true };
        Some(Self { shape, parameters: joined(parts, Self::tensors(shape))?, popart })
    }

    /// The tensors with the layouts of the public code.
    pub fn weights(&self) -> CriticWeights {
        let AllocationShape { features, columns, width, .. } = self.shape;
        let [
            entity,
            task,
            counts,
            count_bias,
            entity_bias,
            attention_in,
            out,
            out_bias,
            value,
            rest @ ..,
        ] = parts(&self.parameters, Self::tensors(self.shape));
        let [value_bias, popart_weight, popart_bias] = rest;
        CriticWeights {
            shape: self.shape,
            entity_weight: transpose(entity, features, width),
            entity_bias: entity_bias.to_vec(),
            task_weight: transpose(task, columns, width),
            count_weight: transpose(counts, 2, width),
            count_bias: count_bias.to_vec(),
            attention_in_weight: attention_in.to_vec(),
            attention_out_weight: out.to_vec(),
            attention_out_bias: out_bias.to_vec(),
            value_weight: value.to_vec(),
            value_bias: value_bias.to_vec(),
            popart_weight: popart_weight[0],
            popart_bias: popart_bias[0],
            mean: self.popart.mean as f32,
            deviation: self.popart.variance.sqrt() as f32,
        }
    }

    /// The sizes.
    pub fn shape(&self) -> AllocationShape {
        self.shape
    }

    /// All parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    pub(super) fn layers(&self) -> CriticLayers {
        CriticLayers::of(self.shape, &mut Places::default())
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
    pub(super) fn head(&self) -> [f32; 2] {
        let head = self.parameters.len() - 2;
        [self.parameters[head], self.parameters[head + 1]]
    }

    /// Weight and bias of the PopArt head, to be changed.
    pub(super) fn head_mut(&mut self) -> (&mut [f32], &mut [f32]) {
        let head = self.parameters.len() - 2;
        self.parameters[head..].split_at_mut(1)
    }
}

/// The policy `f(b | s)` that proposes allocations.
#[derive(Clone, Debug, PartialEq)]
pub struct AllocationPolicy {
    shape: AllocationShape,
    parameters: Vec<f32>,
}

impl AllocationPolicy {
    /// Features, task columns and the bias of the features; queries, keys and values; the projection behind the attention;
    /// counts and their bias; both halves of the update and its bias.
    pub(super) fn tensors(shape: AllocationShape) -> Tensors<11> {
        let AllocationShape { features, columns, width, .. } = shape;
        let square = width * width;
        [
            (features * width, features),
            (columns * width, columns),
            (width, features),
            (3 * square, width),
            (square, width),
            (width, width),
            (2 * width, 2),
            (width, 2),
            (square, 2 * width),
            (square, 2 * width),
            (width, 2 * width),
        ]
    }

    /// Number of parameters of a shape.
    pub fn count(shape: AllocationShape) -> usize {
        count(Self::tensors(shape))
    }

    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: AllocationShape, generator: &mut Generator) -> Self {
        Self { shape, parameters: drawn(Self::tensors(shape), generator) }
    }

    /// A policy with these parameters, or `None` where their number does not fit the shape.
    pub fn from_parameters(shape: AllocationShape, parameters: Vec<f32>) -> Option<Self> {
        (parameters.len() == Self::count(shape)).then_some(Self { shape, parameters })
    }

    /// The policy with these tensors, or `None` where one does not fit the shape.
    pub fn from_weights(weights: &PolicyWeights) -> Option<Self> {
        let shape = weights.shape;
        let AllocationShape { features, columns, width, .. } = shape;
        // Of every row of the update, the task's half stands before the agent's.
        let half = |second: usize| -> Vec<f32> {
            let rows = weights.update_weight.chunks(width).skip(second).step_by(2);
            rows.flatten().copied().collect()
        };
        let parts = [
            transposed(&weights.entity_weight, width, features)?,
            transposed(&weights.task_weight, width, columns)?,
            weights.entity_bias.clone(),
            weights.attention_in_weight.clone(),
            weights.attention_out_weight.clone(),
            weights.attention_out_bias.clone(),
            transposed(&weights.count_weight, width, 2)?,
            weights.count_bias.clone(),
            half(0),
            half(1),
            weights.update_bias.clone(),
        ];
        Some(Self { shape, parameters: joined(parts, Self::tensors(shape))? })
    }

    /// The tensors with the layouts of the public code.
    pub fn weights(&self) -> PolicyWeights {
        let AllocationShape { features, columns, width, .. } = self.shape;
        let [entity, task, entity_bias, attention_in, out, out_bias, counts, count_bias, rest @ ..] =
            parts(&self.parameters, Self::tensors(self.shape));
        let [update_task, update_agent, update_bias] = rest;
        let halves = update_task.chunks(width).zip(update_agent.chunks(width));
        PolicyWeights {
            shape: self.shape,
            entity_weight: transpose(entity, features, width),
            entity_bias: entity_bias.to_vec(),
            task_weight: transpose(task, columns, width),
            attention_in_weight: attention_in.to_vec(),
            attention_out_weight: out.to_vec(),
            attention_out_bias: out_bias.to_vec(),
            count_weight: transpose(counts, 2, width),
            count_bias: count_bias.to_vec(),
            update_weight: halves.flat_map(|(task, agent)| [task, agent].concat()).collect(),
            update_bias: update_bias.to_vec(),
        }
    }

    /// The sizes.
    pub fn shape(&self) -> AllocationShape {
        self.shape
    }

    /// All parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    pub(super) fn layers(&self) -> PolicyLayers {
        PolicyLayers::of(self.shape, &mut Places::default())
    }
}

fn count<const COUNT: usize>(tensors: Tensors<COUNT>) -> usize {
    tensors.iter().map(|(length, _)| length).sum()
}

/// Puts tensors behind each other, or gives `None` where one has another length.
fn joined<const COUNT: usize>(
    parts: [Vec<f32>; COUNT],
    tensors: Tensors<COUNT>,
) -> Option<Vec<f32>> {
    let fits = parts.iter().zip(tensors).all(|(part, (length, _))| part.len() == length);
    fits.then(|| parts.concat())
}

/// The tensors of a flat vector.
fn parts<const COUNT: usize>(parameters: &[f32], tensors: Tensors<COUNT>) -> [&[f32]; COUNT] {
    let mut rest = parameters;
    tensors
        .map(|(length, _)| rest.split_off(..length).expect("as many parameters as the shape has"))
}

/// As [`transpose`], or `None` where the length does not fit.
fn transposed(matrix: &[f32], rows: usize, columns: usize) -> Option<Vec<f32>> {
    (matrix.len() == rows * columns).then(|| transpose(matrix, rows, columns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_learn::random::{Purpose, generator};

    const SHAPE: AllocationShape = AllocationShape { features: 5, columns: 4, width: 8, heads: 2 };

    #[test]
    fn networks_survive_their_tensors() {
        let mut random = generator(1, Purpose::Weights, 0);
        let mut critic = AllocationCritic::initialise(SHAPE, &mut random);
        critic.popart = PopArt { mean: 0.5, variance: 4.0, started: true };
        assert_eq!(AllocationCritic::from_weights(&critic.weights()), Some(critic));
        let policy = AllocationPolicy::initialise(SHAPE, &mut random);
        assert_eq!(AllocationPolicy::from_weights(&policy.weights()), Some(policy.clone()));
        let mut wrong = policy.weights();
        wrong.update_bias.pop();
        assert_eq!(AllocationPolicy::from_weights(&wrong), None);
    }

    #[test]
    fn the_published_sizes_have_the_published_number_of_parameters() {
        let shape = AllocationShape { features: 58, columns: 6, width: 128, heads: 4 };
        assert_eq!(AllocationCritic::count(shape), 74_499);
        assert_eq!(AllocationPolicy::count(shape), 107_264);
        let [critic, policy] = &mut [Places::default(); 2];
        CriticLayers::of(shape, critic);
        PolicyLayers::of(shape, policy);
        assert_eq!([critic.end, policy.end], [74_499, 107_264]);
    }
}
