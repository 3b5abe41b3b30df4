//! The flexible mixer of QMIX with its four hypernetworks and its PopArt head, on a tape.
//!
//! Dissertation sections 5.3.2 and 7.3: `Q = w2 . elu(sum over agents of W1[a] q_a + b1) + V` for every
//! team, then `w Q + b` in normalised units. `W1` and `w2` are made non-negative; the public code of
//! ALMA makes `b1` and `V` so as well, which is a switch here.
//!
//! A hypernetwork makes these numbers from everything around agents or teams: it embeds every entity, lets the agents
//! attend and projects twice. No activation stands between the value matrix and the last layer, so that these three
//! matrices are one: products of parameters, which stand behind the others while networks do not change. Numbers of a
//! team are means over its agents; they are taken before the merged layer is applied.

use std::ops::Range;

use sortie_nn::layers::team_attention::Sums;
use sortie_nn::layers::{SparseRows, TeamLists};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Norm, Parameters, Pass, Places, Tape, Var};

use crate::alma::agents::stacked;
use crate::alma::windows::config::Nonnegative;

/// What a hypernetwork gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// M numbers for every agent.
    Matrix,
    /// M numbers for every team: the mean over its agents.
    Vector,
    /// One number for every team: the mean of its vector.
    Scalar,
}

/// The names of the hypernetworks and what they give, in the order of the parameters.
const HYPERNETWORKS: [(&str, Mode); 4] =
    [("w1", Mode::Matrix), ("b1", Mode::Vector), ("w2", Mode::Vector), ("v", Mode::Scalar)];

/// Sizes of a hypernetwork.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HypernetworkShape {
    /// Input columns of one entity.
    pub input: usize,
    /// Width E of embedding and attention.
    pub width: usize,
    /// Attention heads H, a divisor of the width.
    pub heads: usize,
    /// Mixing width M.
    pub mixing: usize,
}

/// The layers of a hypernetwork, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub struct HypernetworkLayers {
    mode: Mode,
    heads: usize,
    /// `[input, E]`
    fc1: Linear,
    query: Linear,
    key: Linear,
    value: Linear,
    out: Linear,
    /// `[M, E]`
    fc2: Linear,
}

impl HypernetworkLayers {
    /// Adds tensors under a name, drawn uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn new(
        name: &str,
        (shape, mode): (HypernetworkShape, Mode),
        p: &mut Parameters,
        random: &mut Generator,
    ) -> Self {
        let HypernetworkShape { input, width, heads, mixing } = shape;
        let named = |part: &str| format!("mixer.{name}.{part}");
        let fc1 = p.sparse_linear(&named("fc1"), [input, width], input as f32, random);
        let [query, key, value] = stacked(p, &named("attention.in"), (width, [1; 3]), random);
        let out = p.linear(&named("attention.out"), width, width, random);
        let fc2 = p.linear(&named("fc2"), width, mixing, random);
        Self { mode, heads, fc1, query, key, value, out, fc2 }
    }

    /// Value, output and last layer in one, in a row: the weight `[K, H E]`, then the offsets.
    pub fn merged(self, t: &mut Pass<'_>) -> Var {
        let (width, mixing) = (self.fc2.shape.input, self.fc2.shape.output);
        let [out_bias, last_bias] = [self.out, self.fc2].map(|layer| layer.bias.expect("offsets"));
        let mut last = t.parameter(self.fc2.weight, [mixing, width]);
        let mut offsets = t.parameter(last_bias, [mixing, 1]);
        if self.mode == Mode::Scalar {
            (last, offsets) = (t.mean_rows(last), t.mean_rows(offsets));
        }
        let out_bias = t.parameter(out_bias, [1, width]);
        let through = t.product_transposed(last, out_bias);
        let offsets = t.add(offsets, through);
        let [out, value] =
            [self.out, self.value].map(|layer| t.parameter(layer.weight, [width; 2]));
        let projected = t.product(last, out);
        let narrow = width / self.heads;
        let heads = (0..self.heads).map(|head| {
            let own = head * narrow..(head + 1) * narrow;
            let (projected, value) = (t.columns(projected, own.clone()), t.rows(value, own));
            t.product(projected, value)
        });
        let heads: Vec<Var> = heads.collect();
        let weight = t.concat(&heads);
        let parts = [weight, offsets].map(|part| {
            let [rows, columns] = t.size(part);
            t.reshape(part, rows * columns)
        });
        t.concat(&parts)
    }

    /// The numbers `[agents or teams, K]`, where means are over `slots` agents: absent ones count as zeros. The merged
    /// layer has the next place.
    pub fn numbers(
        self,
        t: &mut Pass<'_>,
        merged: &mut Places,
        (input, slots): (&MixerInput, usize),
    ) -> Var {
        let (width, teams) = (self.fc2.shape.input, &input.teams);
        let entities = t.sparse_linear_rectified(&input.rows, self.fc1);
        let own = t.rows(entities, 0..teams.queries());
        let (queries, keys) = (t.linear(own, self.query), t.linear(entities, self.key));
        let outputs = if self.mode == Mode::Scalar { 1 } else { self.fc2.shape.output };
        let layer = merged.projection(self.heads * width, outputs);
        let offsets = merged.numbers(outputs);
        let rows = [queries, keys, entities];
        if self.mode == Mode::Matrix {
            let sums = t.team_attention(rows, teams, Sums::PerQuery, self.heads);
            return t.linear(sums, Linear { bias: Some(offsets), ..layer });
        }
        let sums = t.team_attention(rows, teams, Sums::PerTeam, self.heads);
        let numbers = t.linear(sums, layer);
        // A team has the offsets as often as it has agents.
        let sizes: Vec<f32> = teams.sizes().map(|size| size as f32).collect();
        let (sizes, offsets) = (t.input(1, &sizes), t.parameter(offsets, [1, outputs]));
        let offsets = t.product(sizes, offsets);
        let sum = t.add(numbers, offsets);
        t.scale(sum, 1.0 / slots as f32)
    }
}

/// What a mixer looks at: the entities of any number of teams.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MixerInput {
    /// Features of every entity, those of the teams' agents first.
    pub rows: SparseRows,
    /// The teams, their agents being the queries, and what they attend to.
    pub teams: TeamLists,
}

/// Sizes and switches of a mixer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// Sizes of each of the hypernetworks.
    pub hypernetwork: HypernetworkShape,
    /// Agents A that means are over, absent ones included.
    pub slots: usize,
    /// Pairs of the PopArt head: one that all subtasks share, or one for each.
    pub outputs: usize,
    /// How weights are kept from being negative.
    pub nonnegative: Nonnegative,
    /// Whether `b1` and `V` go through absolute values.
    pub bias_nonnegative: bool,
}

/// A mixer's layers, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Mixer {
    pub(super) shape: MixerShape,
    hypernetworks: [HypernetworkLayers; 4],
    /// Weights and biases of the head, `[outputs]` each.
    head: Norm,
}

impl Mixer {
    /// Adds tensors under `mixer`, drawn likewise; the head changes nothing at first.
    pub fn new(shape: MixerShape, p: &mut Parameters, random: &mut Generator) -> Self {
        let sizes = shape.hypernetwork;
        let own = |(name, mode)| HypernetworkLayers::new(name, (sizes, mode), p, random);
        let hypernetworks = HYPERNETWORKS.map(own);
        Self { shape, hypernetworks, head: p.norm("mixer.head", shape.outputs) }
    }

    /// Where the weights of the head stand, and behind them its biases.
    pub(super) fn head_range(self) -> Range<usize> {
        self.head.start..self.head.start + 2 * self.head.width
    }

    /// The merged layers of all hypernetworks in a row.
    fn merged(self, t: &mut Pass<'_>) -> Var {
        let rows = self.hypernetworks.map(|own| own.merged(t));
        t.concat(&rows)
    }

    /// Puts the merged layers behind the parameters that they follow from.
    pub(super) fn append_merged(self, tape: &mut Tape, parameters: &mut Vec<f32>) {
        let mut t = tape.begin(parameters);
        let merged = self.merged(&mut t);
        let merged = t.values(merged).to_vec();
        parameters.extend(merged);
    }

    /// Takes the gradient of the merged layers, which stands from `merged` on, to that of what they follow from.
    pub(super) fn hand_back(
        self,
        tape: &mut Tape,
        parameters: &[f32],
        (merged, gradient): (usize, &mut Vec<f32>),
    ) {
        let slopes = gradient.split_off(merged);
        let mut t = tape.begin(parameters);
        let row = self.merged(&mut t);
        let loss = t.weighted_sum(row, &slopes);
        t.backward(loss, gradient);
    }

    /// The value `[teams, 1]` of every team before the head, from the utilities `[agents, 1]` of all agents' actions. The
    /// merged layers stand from `merged` on.
    pub(super) fn mix(
        self,
        t: &mut Pass<'_>,
        merged: usize,
        input: &MixerInput,
        utilities: Var,
    ) -> Var {
        let MixerShape { slots, nonnegative, bias_nonnegative, .. } = self.shape;
        let places = &mut Places { end: merged };
        let numbers = self.hypernetworks.map(|own| own.numbers(t, places, (input, slots)));
        let [first, bias, second, state] = numbers;
        let [first, second] = [first, second].map(|weights| match nonnegative {
            Nonnegative::Softmax => t.softmax(weights),
            Nonnegative::Absolute => t.abs(weights),
        });
        let [bias, state] =
            [bias, state].map(|bias| if bias_nonnegative { t.abs(bias) } else { bias });
        let sizes = (0..).zip(input.teams.sizes());
        let team_of = sizes.flat_map(|(team, size)| std::iter::repeat_n(team, size));
        let team_of: Vec<u32> = team_of.collect();
        let weighted = t.scale_rows(first, utilities);
        let sums = t.scatter(weighted, &team_of, input.teams.teams());
        let sums = t.add(sums, bias);
        let hidden = t.elu(sums);
        let products = t.multiply(hidden, second);
        let values = t.sum_columns(products);
        t.add(values, state)
    }

    /// Values `[teams, 1]` in normalised units, each by its own output of the head.
    pub(super) fn head(self, t: &mut Pass<'_>, values: Var, outputs: &[u32]) -> Var {
        let Norm { start, width } = self.head;
        let [weights, biases] = [start, start + width].map(|start| {
            let all = t.parameter(start, [width, 1]);
            t.gather(all, outputs)
        });
        let scaled = t.multiply(values, weights);
        t.add(scaled, biases)
    }
}
