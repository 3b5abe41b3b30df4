//! The utility network of ALMA's agents, shared by all of them (dissertation section 7.3).
//!
//! `fc1` embeds every entity, attention lets the agent look at what it sees, `fc2` and `head` give one
//! utility per action. Feed-forward; the subtask mask decides what is seen, not this network.
//!
//! With a skip, `looked = relu(W_o o + b_o + W_s x)`, with `o` what the agent attends to and `x` its own
//! embedding. The published network has no `W_s`: it sees its own row through attention only.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use sortie_learn::export::{AttentionNetwork, Layer, Layout, Matrix};
use sortie_learn::state;
use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::{Generator, signed_unit};

use super::entity_attention::{AttentionGradients, AttentionWeights};

/// Sizes of a utility network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UtilityShape {
    /// Input columns D of one entity: its features and its last action's one-hot.
    pub input: usize,
    /// Width E of the embedding and the attention.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
    /// Width R of the layer before the head.
    pub base: usize,
    /// Actions U.
    pub actions: usize,
    /// Whether the agent's own embedding skips the attention.
    #[serde(default)]
    pub skip: bool,
}

impl UtilityShape {
    /// What to set so that a network may begin as one that lacks nothing but its skip, or has one too many.
    pub(crate) fn hint_to_become(self, other: Self, key: &str) -> String {
        let differs = Self { skip: other.skip, ..self } == other && self != other;
        if differs { format!(": `--set {key}={}`", other.skip) } else { String::new() }
    }

    pub(super) fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    pub(super) fn queries(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    pub(super) fn fc2(self) -> LinearShape {
        LinearShape { input: self.width, output: self.base }
    }

    pub(super) fn head(self) -> LinearShape {
        LinearShape { input: self.base, output: self.actions }
    }

    /// Where each tensor stands in the flat parameter vector.
    pub fn tensors(self) -> Vec<Tensor> {
        self.places().into_iter().filter(|tensor| !tensor.range.is_empty()).collect()
    }

    /// The same with an empty tensor in the place of a skip that is not there.
    fn places(self) -> [Tensor; 10] {
        let Self { input, width, base, actions, skip, .. } = self;
        let mut start = 0;
        let mut next = |name, rows, columns| {
            let range = start..start + rows * columns;
            start = range.end;
            Tensor { name, rows, columns, range }
        };
        [
            next("fc1.weight", input, width),
            next("fc1.bias", 1, width),
            next("attention.in.weight", 3 * width, width),
            next("attention.out.weight", width, width),
            next("attention.out.bias", 1, width),
            next("fc2.weight", base, width),
            next("fc2.bias", 1, base),
            next("head.weight", actions, base),
            next("head.bias", 1, actions),
            next("skip.weight", if skip { width } else { 0 }, width),
        ]
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.places()[9].range.end
    }
}

/// One tensor in the flat parameter vector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tensor {
    /// Its name in files.
    pub name: &'static str,
    /// Rows of the stored matrix; 1 for a bias.
    pub rows: usize,
    /// Columns of the stored matrix.
    pub columns: usize,
    /// Its place.
    pub range: Range<usize>,
}

/// The network: its sizes and all parameters in one vector.
///
/// Optimiser, target network and weight average work on the vector; only the passes know tensors.
/// `fc1.weight` is stored `[input, width]`, all other matrices `[out, in]`.
#[derive(Clone, Debug, PartialEq)]
pub struct UtilityNetwork {
    shape: UtilityShape,
    parameters: Vec<f32>,
}

flat_network!(UtilityNetwork, UtilityShape);

impl UtilityNetwork {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    ///
    /// For `fc1` the inputs count as `active_inputs`: its rows are one-hot codes with few non-zeros,
    /// so that the full width would make the first activations too small.
    pub fn initialise(shape: UtilityShape, active_inputs: f32, generator: &mut Generator) -> Self {
        let mut parameters = vec![0.0; shape.parameters()];
        let inputs = [active_inputs; 2]
            .into_iter()
            .chain([shape.width as f32; 5])
            .chain([shape.base as f32; 2])
            .chain([shape.width as f32]);
        for (tensor, inputs) in shape.tensors().into_iter().zip(inputs) {
            let bound = 1.0 / inputs.sqrt();
            for value in &mut parameters[tensor.range] {
                *value = bound * signed_unit(generator);
            }
        }
        Self { shape, parameters }
    }

    /// The tensors in PyTorch's layout.
    pub fn weights(&self) -> UtilityWeights {
        let UtilityShape { input, width, .. } = self.shape;
        let [fc1, fc1_bias, attention_in, out, out_bias, fc2, fc2_bias, head, head_bias, skip] =
            self.shape.places().map(|tensor| self.parameters[tensor.range].to_vec());
        UtilityWeights {
            shape: self.shape,
            fc1_weight: transpose(&fc1, input, width),
            fc1_bias,
            attention_in_weight: attention_in,
            attention_out_weight: out,
            attention_out_bias: out_bias,
            fc2_weight: fc2,
            fc2_bias,
            head_weight: head,
            head_bias,
            skip_weight: skip,
        }
    }

    /// The layers, for export.
    pub fn layers(&self) -> AttentionNetwork<'_> {
        let UtilityShape { input, width, heads, base, actions, skip } = self.shape;
        let [fc1, fc1_bias, attention_in, out, out_bias, fc2, fc2_bias, head, head_bias, past] =
            self.shape.places().map(|tensor| &self.parameters[tensor.range]);
        let matrix = |values| Matrix { values, layout: Layout::OutputsFirst };
        let layer = |values, bias| Layer { weight: matrix(values), bias };
        AttentionNetwork {
            inputs: input,
            width,
            heads,
            base,
            outputs: actions,
            fc1: Layer {
                weight: Matrix { values: fc1, layout: Layout::InputsFirst },
                bias: fc1_bias,
            },
            attention_in: matrix(attention_in),
            attention_out: layer(out, out_bias),
            skip: skip.then(|| matrix(past)),
            fc2: Some(layer(fc2, fc2_bias)),
            head: layer(head, head_bias),
            pointing: None,
        }
    }

    /// A network from tensors in PyTorch's layout, or `None` where a length does not fit the shape.
    pub fn from_weights(weights: &UtilityWeights) -> Option<Self> {
        let shape = weights.shape;
        if weights.fc1_weight.len() != shape.input * shape.width {
            return None;
        }
        let fc1 = transpose(&weights.fc1_weight, shape.width, shape.input);
        let tensors = [
            &fc1,
            &weights.fc1_bias,
            &weights.attention_in_weight,
            &weights.attention_out_weight,
            &weights.attention_out_bias,
            &weights.fc2_weight,
            &weights.fc2_bias,
            &weights.head_weight,
            &weights.head_bias,
            &weights.skip_weight,
        ];
        let fits = |(tensor, place): (&&Vec<f32>, Tensor)| tensor.len() == place.range.len();
        if !tensors.iter().zip(shape.places()).all(fits) {
            return None;
        }
        Self::from_parameters(shape, tensors.into_iter().flatten().copied().collect())
    }

    pub(super) fn view(&self) -> UtilityView<'_> {
        let width = self.shape.width;
        let [fc1, fc1_bias, attention_in, out, out_bias, fc2, fc2_bias, head, head_bias, skip] =
            self.shape.places().map(|tensor| &self.parameters[tensor.range]);
        let (queries, keys_values) = attention_in.split_at(width * width);
        UtilityView {
            attention: AttentionWeights { fc1, fc1_bias, queries, keys_values },
            out,
            out_bias,
            fc2,
            fc2_bias,
            head,
            head_bias,
            skip: self.shape.skip.then_some(skip),
        }
    }
}

/// The tensors of a network, borrowed.
#[derive(Clone, Copy, Debug)]
pub(super) struct UtilityView<'a> {
    pub(super) attention: AttentionWeights<'a>,
    pub(super) out: &'a [f32],
    pub(super) out_bias: &'a [f32],
    pub(super) fc2: &'a [f32],
    pub(super) fc2_bias: &'a [f32],
    pub(super) head: &'a [f32],
    pub(super) head_bias: &'a [f32],
    pub(super) skip: Option<&'a [f32]>,
}

/// The tensors of a gradient vector, in the places of the parameters.
#[derive(Debug)]
pub(super) struct UtilityViewMut<'a> {
    pub(super) attention: AttentionGradients<'a>,
    pub(super) out: &'a mut [f32],
    pub(super) out_bias: &'a mut [f32],
    pub(super) fc2: &'a mut [f32],
    pub(super) fc2_bias: &'a mut [f32],
    pub(super) head: &'a mut [f32],
    pub(super) head_bias: &'a mut [f32],
    /// Empty where there is none.
    pub(super) skip: &'a mut [f32],
}

impl<'a> UtilityViewMut<'a> {
    pub(super) fn new(shape: UtilityShape, vector: &'a mut [f32]) -> Self {
        let width = shape.width;
        let mut rest = vector;
        let mut take = |count: usize| rest.split_off_mut(..count).expect("one place per parameter");
        let [fc1, fc1_bias, attention_in, out, out_bias, fc2, fc2_bias, head, head_bias, skip] =
            shape.places().map(|tensor| take(tensor.range.len()));
        let (queries, keys_values) = attention_in.split_at_mut(width * width);
        let attention = AttentionGradients { fc1, fc1_bias, queries, keys_values };
        Self { attention, out, out_bias, fc2, fc2_bias, head, head_bias, skip }
    }
}

/// All tensors in PyTorch's layout: matrices `[out, in]`, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct UtilityWeights {
    /// The sizes D, E, heads, R, U.
    pub shape: UtilityShape,
    /// `[E, D]`
    pub fc1_weight: Vec<f32>,
    /// `[E]`
    pub fc1_bias: Vec<f32>,
    /// `[3 E, E]`: query, key, value; no bias.
    pub attention_in_weight: Vec<f32>,
    /// `[E, E]`
    pub attention_out_weight: Vec<f32>,
    /// `[E]`
    pub attention_out_bias: Vec<f32>,
    /// `[R, E]`
    pub fc2_weight: Vec<f32>,
    /// `[R]`
    pub fc2_bias: Vec<f32>,
    /// `[U, R]`
    pub head_weight: Vec<f32>,
    /// `[U]`
    pub head_bias: Vec<f32>,
    /// `[E, E]`; empty without a skip.
    pub skip_weight: Vec<f32>,
}

/// The transpose of a row-major matrix.
pub(crate) fn transpose(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|j| (0..rows).map(move |i| matrix[i * columns + j])).collect()
}

/// The tensors of a network of this shape, as checkpoints have them.
pub(crate) fn tensors(shape: UtilityShape) -> Vec<state::Tensor> {
    let tensor = |tensor: super::Tensor| state::Tensor {
        name: tensor.name.to_owned(),
        shape: vec![tensor.rows, tensor.columns],
        range: tensor.range,
    };
    shape.tensors().into_iter().map(tensor).collect()
}

#[cfg(test)]
mod tests {
    use sortie_learn::random::{Purpose, generator};

    use super::*;

    const SHAPE: UtilityShape =
        UtilityShape { input: 5, width: 4, heads: 2, base: 3, actions: 2, skip: false };
    const SKIPPING: UtilityShape = UtilityShape { skip: true, ..SHAPE };

    fn drawn(shape: UtilityShape) -> UtilityNetwork {
        UtilityNetwork::initialise(shape, 3.0, &mut generator(1, Purpose::Weights, 0))
    }

    #[test]
    fn a_skip_stands_last_and_moves_nothing() {
        let names =
            |shape: UtilityShape| shape.tensors().iter().map(|t| t.name).collect::<Vec<_>>();
        assert_eq!(names(SHAPE).len(), 9);
        assert_eq!(names(SKIPPING)[..9], names(SHAPE));
        assert_eq!(names(SKIPPING)[9..], ["skip.weight"]);
        let (plain, skipping) = (drawn(SHAPE), drawn(SKIPPING));
        let (before, skip) = skipping.parameters().split_at(SHAPE.parameters());
        assert_eq!(before, plain.parameters());
        assert_eq!(skip.len(), 16);
        assert!(skip.iter().all(|weight| weight.abs() <= 0.5));
        assert!(skip.iter().any(|weight| weight.abs() > 0.3), "{skip:?}");
    }

    #[test]
    fn weights_become_the_network_that_they_come_from() {
        for shape in [SHAPE, SKIPPING] {
            let network = drawn(shape);
            let mut weights = network.weights();
            assert_eq!(UtilityNetwork::from_weights(&weights), Some(network));
            weights.shape.skip = !shape.skip;
            assert_eq!(UtilityNetwork::from_weights(&weights), None);
        }
    }

    #[test]
    fn a_hint_names_the_skip_alone() {
        assert_eq!(SHAPE.hint_to_become(SKIPPING, "network.skip"), ": `--set network.skip=true`");
        assert_eq!(SKIPPING.hint_to_become(SHAPE, "network.skip"), ": `--set network.skip=false`");
        assert_eq!(SHAPE.hint_to_become(UtilityShape { width: 8, ..SKIPPING }, "network.skip"), "");
        assert_eq!(SHAPE.hint_to_become(SHAPE, "network.skip"), "");
    }
}
