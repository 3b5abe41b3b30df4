//! The flexible mixer of QMIX with its four hypernetworks and its PopArt head.
//!
//! Dissertation sections 5.3.2 and 7.3: `Q = w2 . elu(sum over agents of W1[a] q_a + b1) + V` for every
//! team, then `w Q + b` in normalised units. `W1` and `w2` are made non-negative; the public code of
//! ALMA makes `b1` and `V` so as well, which is a switch here.

use sortie_nn::layers::{TeamLists, softmax};
use sortie_nn::random::{Generator, signed_unit};

use super::hypernetwork::{
    HypernetworkGradient, HypernetworkPass, HypernetworkShape, Merged, MixerInput, Mode,
};
use crate::alma::windows::config::Nonnegative;

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

/// The names of the hypernetworks and what they give, in the order of the parameters.
pub const HYPERNETWORKS: [(&str, Mode); 4] =
    [("w1", Mode::Matrix), ("b1", Mode::Vector), ("w2", Mode::Vector), ("v", Mode::Scalar)];

impl MixerShape {
    /// Number of parameters: four hypernetworks, then the head's weights and its biases.
    pub fn parameters(self) -> usize {
        4 * self.hypernetwork.parameters() + 2 * self.outputs
    }

    pub(super) fn hypernetworks<'a>(
        self,
        parameters: &'a [f32],
    ) -> impl Iterator<Item = &'a [f32]> + 'a {
        parameters.chunks_exact(self.hypernetwork.parameters()).take(HYPERNETWORKS.len())
    }
}

/// A mixer: its sizes and all parameters in one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixer {
    shape: MixerShape,
    parameters: Vec<f32>,
}

flat_network!(Mixer, MixerShape);

impl Mixer {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does; the head
    /// changes nothing at first.
    pub fn initialise(shape: MixerShape, generator: &mut Generator) -> Self {
        let mut parameters = Vec::with_capacity(shape.parameters());
        for _ in HYPERNETWORKS {
            for (_, inputs, length) in shape.hypernetwork.tensors() {
                let bound = 1.0 / (inputs as f32).sqrt();
                parameters.extend((0..length).map(|_| bound * signed_unit(generator)));
            }
        }
        parameters.resize(parameters.len() + shape.outputs, 1.0);
        parameters.resize(parameters.len() + shape.outputs, 0.0);
        Self { shape, parameters }
    }

    /// Weights and biases `[outputs]` of the PopArt head.
    pub fn head(&self) -> (&[f32], &[f32]) {
        let outputs = self.shape.outputs;
        self.parameters[self.parameters.len() - 2 * outputs..].split_at(outputs)
    }

    /// The same, to be changed.
    pub fn head_mut(&mut self) -> (&mut [f32], &mut [f32]) {
        let (outputs, length) = (self.shape.outputs, self.parameters.len());
        self.parameters[length - 2 * outputs..].split_at_mut(outputs)
    }

    /// What passes need beside the parameters, as long as these do not change.
    pub fn merge(&self) -> MergedMixer {
        let shape = self.shape.hypernetwork;
        let merged = self.shape.hypernetworks(&self.parameters).zip(HYPERNETWORKS);
        MergedMixer(merged.map(|(own, (_, mode))| Merged::new(shape, mode, own)).collect())
    }
}

/// The merged matrices of a mixer's hypernetworks.
#[derive(Clone, Debug)]
pub struct MergedMixer(Vec<Merged>);

/// The gradient of a mixer as passes add to it.
#[derive(Clone, Debug)]
pub struct MixerGradient {
    hypernetworks: Vec<HypernetworkGradient>,
    /// Of the head's weights and biases.
    pub(super) head: Vec<f32>,
}

impl MixerGradient {
    /// Zeros.
    pub fn new(shape: MixerShape) -> Self {
        let of = |(_, mode)| HypernetworkGradient::new(shape.hypernetwork, mode);
        Self { hypernetworks: HYPERNETWORKS.map(of).into(), head: vec![0.0; 2 * shape.outputs] }
    }

    /// Sets all to zero.
    pub fn clear(&mut self) {
        self.hypernetworks.iter_mut().for_each(HypernetworkGradient::clear);
        self.head.fill(0.0);
    }

    /// Adds another gradient of the same mixer.
    pub fn add(&mut self, other: &Self) {
        for (sum, other) in self.hypernetworks.iter_mut().zip(&other.hypernetworks) {
            sum.add(other);
        }
        self.head.iter_mut().zip(&other.head).for_each(|(sum, value)| *sum += value);
    }

    /// Writes the gradient of all parameters.
    pub fn write(&self, mixer: &Mixer, merged: &MergedMixer, gradient: &mut [f32]) {
        let own = mixer.shape.hypernetwork.parameters();
        let (hypernetworks, head) = gradient.split_at_mut(4 * own);
        let places = hypernetworks.chunks_exact_mut(own);
        let parameters = mixer.shape.hypernetworks(&mixer.parameters).zip(&merged.0);
        for ((part, gradient), (parameters, merged)) in
            self.hypernetworks.iter().zip(places).zip(parameters)
        {
            part.write(parameters, merged, gradient);
        }
        head.copy_from_slice(&self.head);
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct MixerPass {
    hypernetworks: [HypernetworkPass; 4],
    mixing: Mixing,
    gradient: MixingGradient,
}

impl MixerPass {
    /// Floating-point operations of all passes up to now, see [`HypernetworkPass::operations`].
    pub fn operations(&self) -> u64 {
        self.hypernetworks.iter().map(HypernetworkPass::operations).sum()
    }

    /// Computes the value of every team before the head, from the utilities of all agents' actions.
    pub fn forward(
        &mut self,
        mixer: &Mixer,
        merged: &MergedMixer,
        input: &MixerInput,
        utilities: &[f32],
    ) -> &[f32] {
        let MixerShape { hypernetwork, slots, .. } = mixer.shape;
        let mut networks = mixer.shape.hypernetworks(&mixer.parameters).zip(&merged.0);
        let mut modes = HYPERNETWORKS.into_iter();
        let numbers = self.hypernetworks.each_mut().map(|pass| {
            let ((parameters, merged), (_, mode)) =
                networks.next().zip(modes.next()).expect("four hypernetworks");
            pass.forward((hypernetwork, mode, slots), parameters, merged, input)
        });
        self.mixing.forward(mixer.shape, &input.teams, Numbers(numbers), utilities)
    }

    /// Adds to `gradient` that of a loss whose slope by the values of the last forward pass is
    /// `d_values`; returns the slope by the utilities.
    pub fn backward(
        &mut self,
        mixer: &Mixer,
        merged: &MergedMixer,
        input: &MixerInput,
        (utilities, d_values): (&[f32], &[f32]),
        gradient: &mut MixerGradient,
    ) -> &[f32] {
        let MixerShape { hypernetwork, slots, .. } = mixer.shape;
        self.mixing.backward(mixer.shape, &input.teams, utilities, d_values, &mut self.gradient);
        let networks = mixer.shape.hypernetworks(&mixer.parameters).zip(&merged.0);
        let passes = self.hypernetworks.iter_mut().zip(&mut self.gradient.numbers);
        for ((((_, mode), (parameters, merged)), (pass, d_numbers)), gradient) in
            HYPERNETWORKS.into_iter().zip(networks).zip(passes).zip(&mut gradient.hypernetworks)
        {
            let shape = (hypernetwork, mode, slots);
            pass.backward(shape, parameters, merged, input, d_numbers, gradient);
        }
        &self.gradient.utilities
    }
}

/// What the hypernetworks gave: `W1 [agents, M]`, `b1 [teams, M]`, `w2 [teams, M]`, `V [teams]`.
pub(super) struct Numbers<'a>(pub(super) [&'a [f32]; 4]);

/// The mixing layers of all teams of the last forward pass.
#[derive(Clone, Debug, Default)]
struct Mixing {
    /// The numbers as they came, for the signs of those that go through absolute values.
    raw: [Vec<f32>; 4],
    /// `W1 [agents, M]`, not negative.
    first: Vec<f32>,
    /// `[teams, M]`, after the elu.
    hidden: Vec<f32>,
    /// `w2 [teams, M]`, not negative.
    second: Vec<f32>,
    values: Vec<f32>,
}

/// The slopes of a loss.
#[derive(Clone, Debug, Default)]
struct MixingGradient {
    /// By the numbers, in their order.
    pub(super) numbers: [Vec<f32>; 4],
    /// By the utilities `[agents]`.
    pub(super) utilities: Vec<f32>,
}

impl Mixing {
    /// Computes the value of every team from the numbers and the utilities `[agents]`.
    pub(super) fn forward(
        &mut self,
        shape: MixerShape,
        teams: &TeamLists,
        numbers: Numbers<'_>,
        utilities: &[f32],
    ) -> &[f32] {
        let mixing = shape.hypernetwork.mixing;
        let Numbers(numbers) = numbers;
        self.raw.iter_mut().zip(numbers).for_each(|(raw, numbers)| set(raw, numbers));
        let [first, bias, second, state] = numbers;
        for (weights, numbers) in [(&mut self.first, first), (&mut self.second, second)] {
            set(weights, numbers);
            weights.chunks_exact_mut(mixing).for_each(|row| nonnegative(shape.nonnegative, row));
        }
        set(&mut self.hidden, bias);
        set(&mut self.values, state);
        if shape.bias_nonnegative {
            let biases = self.hidden.iter_mut().chain(&mut self.values);
            biases.for_each(|bias| *bias = bias.abs());
        }
        let mut agents = self.first.chunks_exact(mixing).zip(utilities);
        let layers = self.hidden.chunks_exact_mut(mixing).zip(self.second.chunks_exact(mixing));
        for ((size, value), (hidden, second)) in teams.sizes().zip(&mut self.values).zip(layers) {
            for (first, utility) in agents.by_ref().take(size) {
                hidden.iter_mut().zip(first).for_each(|(x, w)| *x += utility * w);
            }
            hidden.iter_mut().for_each(|x| *x = elu(*x));
            *value += second.iter().zip(&*hidden).map(|(w, x)| w * x).sum::<f32>();
        }
        &self.values
    }

    /// Writes the slopes of a loss whose slope by the values of the last forward pass is `d_values`.
    pub(super) fn backward(
        &self,
        shape: MixerShape,
        teams: &TeamLists,
        utilities: &[f32],
        d_values: &[f32],
        gradient: &mut MixingGradient,
    ) {
        let mixing = shape.hypernetwork.mixing;
        let MixingGradient {
            numbers: [d_first, d_bias, d_second, d_state],
            utilities: d_utilities,
        } = gradient;
        d_first.resize(utilities.len() * mixing, 0.0);
        d_bias.resize(d_values.len() * mixing, 0.0);
        d_second.resize(d_values.len() * mixing, 0.0);
        set(d_state, d_values);
        d_utilities.resize(utilities.len(), 0.0);

        let mut agents = self.first.chunks_exact(mixing).zip(utilities);
        let mut d_agents = d_first.chunks_exact_mut(mixing).zip(&mut *d_utilities);
        let layers = self.hidden.chunks_exact(mixing).zip(self.second.chunks_exact(mixing));
        let d_layers = d_bias.chunks_exact_mut(mixing).zip(d_second.chunks_exact_mut(mixing));
        for (((size, d_value), (hidden, second)), (d_hidden, d_second)) in
            teams.sizes().zip(d_values).zip(layers).zip(d_layers)
        {
            for (((d_x, d_w), x), w) in d_hidden.iter_mut().zip(d_second).zip(hidden).zip(second) {
                *d_w = d_value * x;
                *d_x = d_value * w * elu_slope(*x);
            }
            for ((first, utility), (d_first, d_utility)) in
                agents.by_ref().zip(d_agents.by_ref()).take(size)
            {
                *d_utility = first.iter().zip(&*d_hidden).map(|(w, d)| w * d).sum();
                d_first.iter_mut().zip(&*d_hidden).for_each(|(d_w, d)| *d_w = utility * d);
            }
        }
        let [raw_first, raw_bias, raw_second, raw_state] = &self.raw;
        for (weights, raw, slopes) in
            [(&self.first, raw_first, &mut *d_first), (&self.second, raw_second, &mut *d_second)]
        {
            let rows = weights.chunks_exact(mixing).zip(raw.chunks_exact(mixing));
            for ((weights, raw), slopes) in rows.zip(slopes.chunks_exact_mut(mixing)) {
                match shape.nonnegative {
                    Nonnegative::Softmax => softmax::backward(weights, slopes),
                    Nonnegative::Absolute => turn_signs(raw, slopes),
                }
            }
        }
        if shape.bias_nonnegative {
            turn_signs(raw_bias, d_bias);
            turn_signs(raw_state, d_state);
        }
    }
}

fn set(vector: &mut Vec<f32>, values: &[f32]) {
    vector.clear();
    vector.extend_from_slice(values);
}

fn nonnegative(how: Nonnegative, row: &mut [f32]) {
    match how {
        Nonnegative::Softmax => softmax::forward(row),
        Nonnegative::Absolute => row.iter_mut().for_each(|weight| *weight = weight.abs()),
    }
}

/// Turns slopes by absolute values into slopes by what they were taken of.
fn turn_signs(raw: &[f32], slopes: &mut [f32]) {
    for (slope, raw) in slopes.iter_mut().zip(raw) {
        *slope *= if *raw < 0.0 { -1.0 } else { 1.0 };
    }
}

fn elu(x: f32) -> f32 {
    if x > 0.0 { x } else { x.exp_m1() }
}

/// Its slope where it gave `y`.
fn elu_slope(y: f32) -> f32 {
    if y > 0.0 { 1.0 } else { y + 1.0 }
}
