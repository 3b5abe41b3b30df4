//! The allocation networks: their sizes and all parameters in one flat vector each.
//!
//! Features, task and counts of an entity meet in one sum, so they are rows of one embedding here. It is
//! stored `[in, E]` because its inputs are sparse; all other matrices are `[out, in]`.

use std::ops::Range;

use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::{Generator, signed_unit};

use super::{AllocationShape, CriticWeights, PolicyWeights};
use crate::alma::agents::transpose;
use crate::alma::windows::popart::PopArt;

/// What counts of agents and of other entities are multiplied by.
pub(super) const COUNT_SCALE: f32 = 0.2;

impl AllocationShape {
    pub(super) fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    /// A layer from width to width.
    pub(super) fn square(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    pub(super) fn keys_values(self) -> LinearShape {
        LinearShape { input: self.width, output: 2 * self.width }
    }
}

/// The critic's tensors: their values, places or gradients.
#[derive(Clone, Debug)]
pub(super) struct CriticParts<P> {
    /// `[d + T + 3, E]`: features; task columns; the counts of agents and of other entities and 1, these
    /// three times [`COUNT_SCALE`].
    pub(super) embedding: P,
    pub(super) embedding_bias: P,
    pub(super) queries: P,
    /// `[2 E, E]`
    pub(super) keys_values: P,
    pub(super) out: P,
    pub(super) out_bias: P,
    /// `[E]`
    pub(super) value: P,
    pub(super) value_bias: P,
    pub(super) popart_weight: P,
    pub(super) popart_bias: P,
}

impl<P> CriticParts<P> {
    /// Takes tensor after tensor, each of so many numbers, in the order of the flat vector.
    fn take(shape: AllocationShape, mut next: impl FnMut(usize) -> P) -> Self {
        let AllocationShape { features, columns, width, .. } = shape;
        Self {
            embedding: next((features + columns + 3) * width),
            embedding_bias: next(width),
            queries: next(width * width),
            keys_values: next(2 * width * width),
            out: next(width * width),
            out_bias: next(width),
            value: next(width),
            value_bias: next(1),
            popart_weight: next(1),
            popart_bias: next(1),
        }
    }
}

/// The policy's tensors: their values, places or gradients.
#[derive(Clone, Debug)]
pub(super) struct PolicyParts<P> {
    /// `[d + T, E]`: features; task columns.
    pub(super) embedding: P,
    pub(super) embedding_bias: P,
    pub(super) queries: P,
    /// `[2 E, E]`
    pub(super) keys_values: P,
    pub(super) out: P,
    pub(super) out_bias: P,
    /// `[3, E]`: other entities, agents, 1; only the counts are times [`COUNT_SCALE`].
    pub(super) count: P,
    /// The half of the update that sees the task.
    pub(super) update_task: P,
    /// The half of the update that sees the agent.
    pub(super) update_agent: P,
    pub(super) update_bias: P,
}

impl<P> PolicyParts<P> {
    fn take(shape: AllocationShape, mut next: impl FnMut(usize) -> P) -> Self {
        let AllocationShape { features, columns, width, .. } = shape;
        Self {
            embedding: next((features + columns) * width),
            embedding_bias: next(width),
            queries: next(width * width),
            keys_values: next(2 * width * width),
            out: next(width * width),
            out_bias: next(width),
            count: next(3 * width),
            update_task: next(width * width),
            update_agent: next(width * width),
            update_bias: next(width),
        }
    }
}

/// Hands out ranges, one behind the other.
fn ranges() -> impl FnMut(usize) -> Range<usize> {
    let mut start = 0;
    move |length| {
        start += length;
        start - length..start
    }
}

/// Hands out pieces of a slice.
fn pieces<'a>(mut rest: &'a [f32]) -> impl FnMut(usize) -> &'a [f32] {
    move |length| rest.split_off(..length).expect("as many parameters as the shape has")
}

/// Hands out pieces of a slice to be changed.
fn pieces_mut<'a>(mut rest: &'a mut [f32]) -> impl FnMut(usize) -> &'a mut [f32] {
    move |length| rest.split_off_mut(..length).expect("as many parameters as the shape has")
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
    /// Number of parameters of a shape.
    pub fn count(shape: AllocationShape) -> usize {
        Self::places(shape).popart_bias.end
    }

    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does; the head of
    /// PopArt begins as the identity.
    pub fn initialise(shape: AllocationShape, generator: &mut Generator) -> Self {
        let AllocationShape { features, columns, width, .. } = shape;
        let mut parameters = vec![0.0; Self::count(shape)];
        let parts = CriticParts::take(shape, pieces_mut(&mut parameters));
        draw_embedding(shape, parts.embedding, parts.embedding_bias, generator);
        let counts = &mut parameters[(features + columns) * width..][..3 * width];
        draw(counts, 2, generator);
        let parts = CriticParts::take(shape, pieces_mut(&mut parameters));
        for tensor in [
            parts.queries,
            parts.keys_values,
            parts.out,
            parts.out_bias,
            parts.value,
            parts.value_bias,
        ] {
            draw(tensor, width, generator);
        }
        parts.popart_weight.fill(1.0);
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
        let counts = transposed(&weights.count_weight, width, 2)?;
        let embedding = [
            transposed(&weights.entity_weight, width, features)?,
            transposed(&weights.task_weight, width, columns)?,
            counts,
            weights.count_bias.clone(),
        ]
        .concat();
        let (queries, keys_values) = weights.attention_in_weight.split_at_checked(width * width)?;
        let mut parameters = vec![0.0; Self::count(shape)];
        let parts = CriticParts::take(shape, pieces_mut(&mut parameters));
        fill(parts.embedding, &embedding)?;
        fill(parts.embedding_bias, &weights.entity_bias)?;
        fill(parts.queries, queries)?;
        fill(parts.keys_values, keys_values)?;
        fill(parts.out, &weights.attention_out_weight)?;
        fill(parts.out_bias, &weights.attention_out_bias)?;
        fill(parts.value, &weights.value_weight)?;
        fill(parts.value_bias, &weights.value_bias)?;
        parts.popart_weight[0] = weights.popart_weight;
        parts.popart_bias[0] = weights.popart_bias;
        let (mean, deviation) = (f64::from(weights.mean), f64::from(weights.deviation));
        let popart = PopArt { mean, variance: deviation * deviation, started: true };
        Some(Self { shape, parameters, popart })
    }

    /// The tensors with the layouts of the public code.
    pub fn weights(&self) -> CriticWeights {
        let AllocationShape { features, columns, width, .. } = self.shape;
        let parts = self.parts();
        let (entity, rest) = parts.embedding.split_at(features * width);
        let (task, rest) = rest.split_at(columns * width);
        let (count, count_bias) = rest.split_at(2 * width);
        CriticWeights {
            shape: self.shape,
            entity_weight: transpose(entity, features, width),
            entity_bias: parts.embedding_bias.to_vec(),
            task_weight: transpose(task, columns, width),
            count_weight: transpose(count, 2, width),
            count_bias: count_bias.to_vec(),
            attention_in_weight: [parts.queries, parts.keys_values].concat(),
            attention_out_weight: parts.out.to_vec(),
            attention_out_bias: parts.out_bias.to_vec(),
            value_weight: parts.value.to_vec(),
            value_bias: parts.value_bias.to_vec(),
            popart_weight: parts.popart_weight[0],
            popart_bias: parts.popart_bias[0],
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

    /// The value of an output of the network before its PopArt head, in real units.
    pub fn real(&self, raw: f32) -> f64 {
        let (weight, bias) = self.head();
        self.popart.denormalise(f64::from(weight * raw + bias))
    }

    /// 1 where [`Self::real`] rises with the output, -1 where it falls.
    ///
    /// Nothing keeps the learned weight of the head positive, and deployment ranks what comes behind it.
    pub(super) fn rises(&self) -> f32 {
        let (weight, _) = self.head();
        f32::from(i8::from(weight > 0.0) - i8::from(weight < 0.0))
    }

    /// Weight and bias of the PopArt head.
    pub(super) fn head(&self) -> (f32, f32) {
        let parts = self.parts();
        (parts.popart_weight[0], parts.popart_bias[0])
    }

    /// Weight and bias of the PopArt head, to be changed.
    pub(super) fn head_mut(&mut self) -> (&mut [f32], &mut [f32]) {
        let parts = Self::parts_of(self.shape, &mut self.parameters);
        (parts.popart_weight, parts.popart_bias)
    }

    /// Where every tensor stands in the flat vector.
    pub(super) fn places(shape: AllocationShape) -> CriticParts<Range<usize>> {
        CriticParts::take(shape, ranges())
    }

    pub(super) fn parts(&self) -> CriticParts<&[f32]> {
        CriticParts::take(self.shape, pieces(&self.parameters))
    }

    /// Gradients or values of the same sizes.
    pub(super) fn parts_of(shape: AllocationShape, flat: &mut [f32]) -> CriticParts<&mut [f32]> {
        CriticParts::take(shape, pieces_mut(flat))
    }
}

/// The policy `f(b | s)` that proposes allocations.
#[derive(Clone, Debug, PartialEq)]
pub struct AllocationPolicy {
    shape: AllocationShape,
    parameters: Vec<f32>,
}

impl AllocationPolicy {
    /// Number of parameters of a shape.
    pub fn count(shape: AllocationShape) -> usize {
        Self::places(shape).update_bias.end
    }

    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: AllocationShape, generator: &mut Generator) -> Self {
        let width = shape.width;
        let mut parameters = vec![0.0; Self::count(shape)];
        let parts = Self::parts_of(shape, &mut parameters);
        draw_embedding(shape, parts.embedding, parts.embedding_bias, generator);
        for (tensor, inputs) in [
            (parts.queries, width),
            (parts.keys_values, width),
            (parts.out, width),
            (parts.out_bias, width),
            (parts.count, 2),
            (parts.update_task, 2 * width),
            (parts.update_agent, 2 * width),
            (parts.update_bias, 2 * width),
        ] {
            draw(tensor, inputs, generator);
        }
        Self { shape, parameters }
    }

    /// A policy with these parameters, or `None` where their number does not fit the shape.
    pub fn from_parameters(shape: AllocationShape, parameters: Vec<f32>) -> Option<Self> {
        (parameters.len() == Self::count(shape)).then_some(Self { shape, parameters })
    }

    /// The policy with these tensors, or `None` where one does not fit the shape.
    pub fn from_weights(weights: &PolicyWeights) -> Option<Self> {
        let shape = weights.shape;
        let AllocationShape { features, columns, width, .. } = shape;
        let embedding = [
            transposed(&weights.entity_weight, width, features)?,
            transposed(&weights.task_weight, width, columns)?,
        ]
        .concat();
        let count = [transposed(&weights.count_weight, width, 2)?, weights.count_bias.clone()];
        let (queries, keys_values) = weights.attention_in_weight.split_at_checked(width * width)?;
        // Transposed, the half of the task stands before the half of the agent.
        let update = transposed(&weights.update_weight, width, 2 * width)?;
        let (update_task, update_agent) = update.split_at(width * width);
        let mut parameters = vec![0.0; Self::count(shape)];
        let parts = Self::parts_of(shape, &mut parameters);
        fill(parts.embedding, &embedding)?;
        fill(parts.embedding_bias, &weights.entity_bias)?;
        fill(parts.queries, queries)?;
        fill(parts.keys_values, keys_values)?;
        fill(parts.out, &weights.attention_out_weight)?;
        fill(parts.out_bias, &weights.attention_out_bias)?;
        fill(parts.count, &count.concat())?;
        fill(parts.update_task, &transpose(update_task, width, width))?;
        fill(parts.update_agent, &transpose(update_agent, width, width))?;
        fill(parts.update_bias, &weights.update_bias)?;
        Some(Self { shape, parameters })
    }

    /// The tensors with the layouts of the public code.
    pub fn weights(&self) -> PolicyWeights {
        let AllocationShape { features, columns, width, .. } = self.shape;
        let parts = self.parts();
        let (entity, task) = parts.embedding.split_at(features * width);
        let (count, count_bias) = parts.count.split_at(2 * width);
        let halves = parts.update_task.chunks(width).zip(parts.update_agent.chunks(width));
        PolicyWeights {
            shape: self.shape,
            entity_weight: transpose(entity, features, width),
            entity_bias: parts.embedding_bias.to_vec(),
            task_weight: transpose(task, columns, width),
            attention_in_weight: [parts.queries, parts.keys_values].concat(),
            attention_out_weight: parts.out.to_vec(),
            attention_out_bias: parts.out_bias.to_vec(),
            count_weight: transpose(count, 2, width),
            count_bias: count_bias.to_vec(),
            update_weight: halves.flat_map(|(task, agent)| [task, agent].concat()).collect(),
            update_bias: parts.update_bias.to_vec(),
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

    /// Where every tensor stands in the flat vector.
    pub(super) fn places(shape: AllocationShape) -> PolicyParts<Range<usize>> {
        PolicyParts::take(shape, ranges())
    }

    pub(super) fn parts(&self) -> PolicyParts<&[f32]> {
        PolicyParts::take(self.shape, pieces(&self.parameters))
    }

    /// Gradients or values of the same sizes.
    pub(super) fn parts_of(shape: AllocationShape, flat: &mut [f32]) -> PolicyParts<&mut [f32]> {
        PolicyParts::take(shape, pieces_mut(flat))
    }
}

/// Draws the rows of features and task columns, and the bias of the features.
fn draw_embedding(
    shape: AllocationShape,
    embedding: &mut [f32],
    bias: &mut [f32],
    generator: &mut Generator,
) {
    let AllocationShape { features, columns, width, .. } = shape;
    let (entity, rest) = embedding.split_at_mut(features * width);
    draw(entity, features, generator);
    draw(bias, features, generator);
    draw(&mut rest[..columns * width], columns, generator);
}

fn draw(tensor: &mut [f32], inputs: usize, generator: &mut Generator) {
    let bound = 1.0 / (inputs as f32).sqrt();
    tensor.iter_mut().for_each(|value| *value = bound * signed_unit(generator));
}

/// Fills a tensor, or gives `None` where the lengths differ.
fn fill(tensor: &mut [f32], values: &[f32]) -> Option<()> {
    (tensor.len() == values.len()).then(|| tensor.copy_from_slice(values))
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
    }
}
