//! The utility network of ALMA's agents, shared by all of them (dissertation section 7.3).
//!
//! `fc1` embeds every entity, attention lets the agent look at what it sees, `fc2` and `head` give one
//! utility per action. Feed-forward; the subtask mask decides what is seen, not this network.
//!
//! With a skip, `looked = relu(W_o o + b_o + W_s x)`, with `o` what the agent attends to and `x` its own
//! embedding. The published network has no `W_s`: it sees its own row through attention only.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use sortie_core::{DecideError, Observation, Policy};
use sortie_learn::export::{AttentionNetwork, Layer, Layout, Matrix};
use sortie_learn::networks::{
    AimView, Aims, Attended, EntityAttention, OwnPass, OwnView, Targets, View,
};
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::layers::{SparseRows, VisibleLists};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Places, Tape, Tensor, Var};

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

/// What the network looks at: the entities of any number of independent samples.
///
/// Query i belongs to row i: the rows of all acting agents come first, then the other entities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UtilityInput {
    /// Features `[rows, D]` of every entity, last actions included.
    pub rows: SparseRows,
    /// For each acting agent the rows that it sees, its own among them where it is visible.
    pub visible: VisibleLists,
    /// What the actions of acting agents aim at.
    pub aims: Aims,
}

impl UtilityInput {
    /// Forgets all samples, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.visible.clear();
        self.aims.clear();
    }

    /// The same without what is aimed at.
    pub fn view(&self) -> View<'_> {
        View { rows: &self.rows, own: &[], lists: &self.visible, imagines: false }
    }
}

/// The layers of a utility network, in the order of its tensors.
#[derive(Clone, Copy, Debug)]
pub struct UtilityLayers {
    looking: EntityAttention,
    out: Linear,
    fc2: Linear,
    head: Linear,
    skip: Option<Linear>,
    /// Makes the vector that points.
    pointing: Option<Linear>,
}

/// What a utility network has made of its input before the head.
#[derive(Clone, Copy, Debug)]
pub struct Looked {
    /// The embeddings of all rows `[rows, E]`, and what each agent attends to, `[agents, E]`.
    attended: Attended,
    /// What stands before the head, `[agents, R]`: there memories and strategies come in.
    pub base: Var,
}

impl UtilityLayers {
    /// Those of a network of this shape.
    pub fn of(shape: UtilityShape) -> Self {
        let places = &mut Places::default();
        let UtilityShape { input, width, heads, base, actions, skip, targets } = shape;
        Self {
            looking: EntityAttention {
                embed: places.linear(input, width),
                queries: places.projection(width, width),
                keys_values: places.projection(width, 2 * width),
                heads,
                absorbs: true,
            },
            out: places.linear(width, width),
            fc2: places.linear(width, base),
            head: places.linear(base, actions - targets.count),
            skip: skip.then(|| places.projection(width, width)),
            pointing: (targets.count > 0).then(|| places.linear(base, targets.reach(width))),
        }
    }

    /// Everything before the head.
    pub fn look(self, t: &mut Pass<'_>, view: View<'_>) -> Looked {
        let attended = self.looking.attend(t, view);
        let looked = match self.skip {
            Some(skip) => {
                let own = attended.own(t, view);
                t.linear_sum_rectified([attended.output, own], [self.out, skip])
            }
            None => t.linear_rectified(attended.output, self.out),
        };
        Looked { attended, base: t.linear_rectified(looked, self.fc2) }
    }

    /// The utilities `[agents, U]` of what stands before the head.
    pub fn head(self, t: &mut Pass<'_>, looked: Looked, aims: AimView<'_>) -> Var {
        let untargeted = t.linear(looked.base, self.head);
        let Some(pointing) = self.pointing else { return untargeted };
        let vectors = t.linear(looked.base, pointing);
        let aimed = aims.point(t, [vectors, looked.attended.embeddings]);
        t.concat(&[untargeted, aimed])
    }

    /// The utilities `[agents, U]` of agents without memories and strategies.
    pub fn utilities(self, t: &mut Pass<'_>, input: &UtilityInput) -> Var {
        let looked = self.look(t, input.view());
        self.head(t, looked, input.aims.all())
    }
}

impl<'a> UtilityView<'a> {
    /// The layers, for export.
    pub fn layers(self) -> AttentionNetwork<'a> {
        let (shape, values) = (self.shape, self.parameters);
        let UtilityShape { input, width, heads, base, actions, targets, .. } = shape;
        let UtilityLayers { looking, out, fc2, head, skip, pointing } = UtilityLayers::of(shape);
        let whole = |layer: Linear| Layer::of(layer, values, Layout::OutputsFirst);
        let attention_in = looking.queries.weight..looking.keys_values.weight_range().end;
        AttentionNetwork {
            inputs: input,
            width,
            heads,
            base,
            outputs: actions,
            fc1: Layer::of(looking.embed, values, Layout::InputsFirst),
            attention_in: Matrix { values: &values[attention_in], layout: Layout::OutputsFirst },
            attention_out: whole(out),
            fc2: Some(whole(fc2)),
            head: whole(head),
            skip: skip.map(|skip| whole(skip).weight),
            pointing: pointing.map(|pointing| targets.deployed(pointing, values)),
        }
    }
}

/// Adds projections that stand behind each other as one tensor, each with so many times as many outputs as inputs.
pub(crate) fn stacked<const COUNT: usize>(
    p: &mut Parameters,
    name: &str,
    (width, times): (usize, [usize; COUNT]),
    random: &mut Generator,
) -> [Linear; COUNT] {
    let mut whole = p.projection(name, width, times.iter().sum::<usize>() * width, random);
    times.map(|times| {
        let own = Linear { shape: LinearShape { input: width, output: times * width }, ..whole };
        whole.weight = own.weight_range().end;
        own
    })
}

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
#[derive(Debug)]
pub struct NetworkPolicy<'a> {
    network: UtilityView<'a>,
    tape: Tape,
    own: OwnView,
    /// What the last answer attended to, `[entities, heads]`.
    attention: Vec<f32>,
}

impl<'a> NetworkPolicy<'a> {
    /// Decides with a network.
    pub fn new(network: UtilityView<'a>) -> Self {
        let (tape, own) = (Tape::default(), OwnView::default());
        Self { network, tape, own, attention: Vec::new() }
    }

    /// What the last answer attended to: every visible entity of `observation`, which must be the one
    /// that was answered, with its weights `[heads]`; those of one head sum to 1.
    pub fn attention(
        &self,
        observation: &Observation<'_>,
    ) -> impl Iterator<Item = (usize, &[f32])> {
        let own = observation.self_index;
        let visible = observation.visible;
        let own_first = visible.contains(own).then_some(own);
        let others: Vec<usize> = visible.iter().filter(|entity| *entity != own).collect();
        let weights = self.attention.chunks_exact(self.network.shape.heads);
        own_first.into_iter().chain(others).zip(weights)
    }

    /// The utilities `[U]` of an agent's actions.
    ///
    /// # Errors
    /// It is shown too few features.
    pub fn utilities(&mut self, observation: &Observation<'_>) -> Result<Vec<f32>, DecideError> {
        let Self { network, tape, own, attention } = self;
        let UtilityShape { input, actions, targets, .. } = network.shape;
        own.look(observation, [input - actions, actions], targets)?;
        let (layers, view) = (UtilityLayers::of(network.shape), own.batch.seen());
        let mut pass = tape.begin(network.parameters);
        let looked = layers.look(&mut pass, view);
        let utilities = layers.head(&mut pass, looked, own.batch.aims(view));
        attention.clear();
        attention.extend(pass.attention_weights(looked.attended.output).unwrap_or_default());
        Ok(pass.values(utilities).to_vec())
    }

    /// The same as a policy.
    pub fn deployed(mut self) -> impl Policy + use<'a> {
        let actions = self.network.shape.actions;
        let utilities = move |seen: &Observation<'_>, _: &mut [f32]| self.utilities(seen);
        OwnPass { actions, memory: 0, utilities }
    }
}

/// The transpose of a row-major matrix.
pub fn transpose(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|j| (0..rows).map(move |i| matrix[i * columns + j])).collect()
}

#[cfg(test)]
pub(crate) mod tests {
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

    /// A network whose weights were drawn with a number of their own.
    pub(crate) fn network(shape: UtilityShape, active_inputs: f32, number: u64) -> UtilityNetwork {
        let mut parameters = Parameters::default();
        shape.draw(&mut parameters, active_inputs, &mut generator(number, Purpose::Weights, 0));
        UtilityNetwork { shape, parameters: parameters.values }
    }

    fn drawn(shape: UtilityShape) -> UtilityNetwork {
        network(shape, 3.0, 1)
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
