//! The utility network of ALMA's agents, shared by all of them (dissertation section 7.3).
//!
//! `fc1` embeds every entity, attention lets the agent look at what it sees, `fc2` and `head` give one
//! utility per action. Feed-forward; the subtask mask decides what is seen, not this network.
//!
//! With a skip, `looked = relu(W_o o + b_o + W_s x)`, with `o` what the agent attends to and `x` its own
//! embedding. The published network has no `W_s`: it sees its own row through attention only.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use sortie_learn::networks::Targets;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Parameters, Tensor};

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
    /// What the last actions aim at, where the head points at it.
    #[serde(default)]
    pub targets: Targets,
}

impl UtilityShape {
    /// What to set so that a network may begin as one that lacks nothing but its skip, or has one too many.
    pub(crate) fn hint_to_become(self, other: Self, key: &str) -> String {
        let differs = Self { skip: other.skip, ..self } == other && self != other;
        if differs { format!(": `--set {key}={}`", other.skip) } else { String::new() }
    }

    /// The tensors, one behind the other. `fc1.weight` is `[input, width]`, all other matrices are `[out, in]`.
    pub fn tensors(self) -> Vec<Tensor> {
        let Self { input, width, base, actions, skip, targets, .. } = self;
        let reach = targets.reach(width);
        let sizes = [
            ("fc1.weight", [input, width]),
            ("fc1.bias", [1, width]),
            ("attention.in.weight", [3 * width, width]),
            ("attention.out.weight", [width, width]),
            ("attention.out.bias", [1, width]),
            ("fc2.weight", [base, width]),
            ("fc2.bias", [1, base]),
            ("head.weight", [actions - targets.count, base]),
            ("head.bias", [1, actions - targets.count]),
            ("skip.weight", [width, width]),
            ("pointing.weight", [reach, base]),
            ("pointing.bias", [1, reach]),
        ];
        let has = |name: &str| match &name[..4] {
            "skip" => skip,
            "poin" => targets.count > 0,
            _ => true,
        };
        let mut end = 0;
        let tensors = sizes.into_iter().filter(|(name, _)| has(name)).map(|(name, shape)| {
            let start = end;
            end += shape[0] * shape[1];
            Tensor { name: name.to_owned(), shape: shape.to_vec(), range: start..end }
        });
        tensors.collect()
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.tensors().last().map_or(0, |last| last.range.end)
    }

    /// Adds a network's tensors, drawn uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    ///
    /// For `fc1` the inputs count as `active_inputs`: its rows are one-hot codes with few non-zeros,
    /// so that the full width would make the first activations too small.
    pub fn draw(self, parameters: &mut Parameters, active_inputs: f32, random: &mut Generator) {
        let first = parameters.values.len();
        for tensor in self.tensors() {
            let inputs = match &tensor.name[..3] {
                "fc1" => active_inputs,
                "hea" | "poi" => self.base as f32,
                _ => self.width as f32,
            };
            parameters.tensor(&tensor.name, &tensor.shape, 1.0 / inputs.sqrt(), random);
        }
        // What is told of pairs is for the head that points; rows that are learned from are without it.
        self.forget(&mut parameters.values[first..], self.targets.pairs());
    }

    /// Takes columns of rows out of all parameters: rows that are learned from are without them, deployed ones are not.
    pub fn forget(self, parameters: &mut [f32], columns: Range<usize>) {
        parameters[columns.start * self.width..columns.end * self.width].fill(0.0);
    }
}

/// The network: its sizes and all parameters in one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct UtilityNetwork {
    /// The sizes.
    pub shape: UtilityShape,
    /// All parameters, in the order of the shape's tensors.
    pub parameters: Vec<f32>,
}

impl UtilityNetwork {
    /// Draws all weights and biases, see [`UtilityShape::draw`].
    pub fn initialise(shape: UtilityShape, active_inputs: f32, generator: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        shape.draw(&mut parameters, active_inputs, generator);
        Self { shape, parameters: parameters.values }
    }

    /// The network, borrowed.
    pub fn view(&self) -> UtilityView<'_> {
        UtilityView { shape: self.shape, parameters: &self.parameters }
    }
}

/// A network whose parameters belong to somebody else.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UtilityView<'a> {
    /// Its sizes.
    pub shape: UtilityShape,
    /// Its parameters; others may follow.
    pub parameters: &'a [f32],
}

/// The transpose of a row-major matrix.
pub fn transpose(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|j| (0..rows).map(move |i| matrix[i * columns + j])).collect()
}

#[cfg(test)]
mod tests {
    use sortie_learn::random::{Purpose, generator};

    use super::*;

    const SHAPE: UtilityShape = UtilityShape {
        input: 5,
        width: 4,
        heads: 2,
        base: 3,
        actions: 2,
        skip: false,
        targets: Targets::NONE,
    };
    const SKIPPING: UtilityShape = UtilityShape { skip: true, ..SHAPE };

    fn drawn(shape: UtilityShape) -> UtilityNetwork {
        UtilityNetwork::initialise(shape, 3.0, &mut generator(1, Purpose::Weights, 0))
    }

    #[test]
    fn a_skip_stands_last_and_moves_nothing() {
        let names = |shape: UtilityShape| {
            shape.tensors().into_iter().map(|tensor| tensor.name).collect::<Vec<_>>()
        };
        assert_eq!(names(SHAPE).len(), 9);
        assert_eq!(names(SKIPPING)[..9], names(SHAPE));
        assert_eq!(names(SKIPPING)[9..], ["skip.weight"]);
        let (plain, skipping) = (drawn(SHAPE), drawn(SKIPPING));
        let (before, skip) = skipping.parameters.split_at(SHAPE.parameters());
        assert_eq!(before, plain.parameters);
        assert_eq!(skip.len(), 16);
        assert!(skip.iter().all(|weight| weight.abs() <= 0.5));
        assert!(skip.iter().any(|weight| weight.abs() > 0.3), "{skip:?}");
    }

    #[test]
    fn embeddings_are_made_without_what_is_told_of_pairs() {
        let targets = Targets { first: 1, count: 1, first_pair: 2, pair_features: 2 };
        let network = drawn(UtilityShape { targets, ..SKIPPING });
        let is_zero: Vec<bool> = network.parameters.iter().map(|weight| *weight == 0.0).collect();
        assert!((0..20).all(|weight| is_zero[weight] == (8..16).contains(&weight)));
        assert!(is_zero[20..].iter().all(|is_zero| !is_zero));
        let names: Vec<String> = network.shape.tensors().into_iter().map(|it| it.name).collect();
        assert_eq!(names[9..], ["skip.weight", "pointing.weight", "pointing.bias"]);
        let head = network.view().layers().pointing.unwrap();
        let start = network.shape.parameters() - 6 - 6 * 3;
        assert_eq!(head.query.weight.values, &network.parameters[start..][..4 * 3]);
    }

    #[test]
    fn a_hint_names_the_skip_alone() {
        assert_eq!(SHAPE.hint_to_become(SKIPPING, "network.skip"), ": `--set network.skip=true`");
        assert_eq!(SKIPPING.hint_to_become(SHAPE, "network.skip"), ": `--set network.skip=false`");
        assert_eq!(SHAPE.hint_to_become(UtilityShape { width: 8, ..SKIPPING }, "network.skip"), "");
        assert_eq!(SHAPE.hint_to_become(SHAPE, "network.skip"), "");
    }
}
