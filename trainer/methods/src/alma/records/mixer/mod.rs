//! Mixing networks: the value of a team from the utilities of its agents' chosen actions.
//!
//! Used in training only. A mixer sees the same rows as the agents that it mixes, so that the subtask
//! mask holds for it as well (dissertation section 7.3).

mod hypernetwork;
#[cfg(test)]
mod tests;

use std::ops::Range;

use sortie_learn::words;
use sortie_nn::layers::softmax;
use sortie_nn::random::{Generator, signed_unit};

use crate::alma::agents::UtilityInput;
use crate::sized;
use hypernetwork::{HypernetworkPass, HypernetworkShape};

words! {
    /// How the utilities of a team become its value.
    MixerKind {
        /// Their sum (VDN).
        Sum = "sum",
        /// A sum with weights that add up to 1, and a value of the state.
        Linear = "linear",
        /// Two layers with non-negative weights (QMIX).
        Qmix = "qmix",
    }
}

/// Sizes of a mixer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// How it mixes.
    pub kind: MixerKind,
    /// Input columns D of one entity, as of the utility network.
    pub input: usize,
    /// Width of the hypernetwork's embedding and attention.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
    /// Width M between the two layers of QMIX.
    pub mixing: usize,
}

impl MixerShape {
    fn hypernetwork(self) -> HypernetworkShape {
        let Self { kind, input, width, heads, mixing } = self;
        let outputs = if kind == MixerKind::Qmix { qmix_outputs(mixing) } else { LINEAR_OUTPUTS };
        HypernetworkShape { input, width, heads, outputs }
    }

    /// Where each tensor stands in the flat parameter vector; a sum has none.
    pub fn tensors(self) -> Vec<MixerTensor> {
        match self.kind {
            MixerKind::Sum => Vec::new(),
            MixerKind::Linear | MixerKind::Qmix => self.hypernetwork().tensors().into(),
        }
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.tensors().last().map_or(0, |tensor| tensor.range.end)
    }
}

/// One tensor in the flat parameter vector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MixerTensor {
    /// Its name.
    pub name: &'static str,
    /// Inputs of its layer.
    pub inputs: usize,
    /// Its place.
    pub range: Range<usize>,
}

/// A mixer: its sizes and all parameters in one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixer {
    shape: MixerShape,
    parameters: Vec<f32>,
}

flat_network!(Mixer, MixerShape);

impl Mixer {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does, where `fc1`
    /// counts as having `active_inputs`, as the utility network's.
    pub fn initialise(shape: MixerShape, active_inputs: f32, generator: &mut Generator) -> Self {
        let mut parameters = vec![0.0; shape.parameters()];
        for (place, tensor) in shape.tensors().into_iter().enumerate() {
            let inputs = if place < 2 { active_inputs } else { tensor.inputs as f32 };
            for value in &mut parameters[tensor.range] {
                *value = signed_unit(generator) / inputs.sqrt();
            }
        }
        Self { shape, parameters }
    }
}

/// Teams to mix: those of an input, one behind the other.
#[derive(Clone, Copy, Debug)]
pub struct Teams<'a> {
    /// What the agents see; its acting agents are those of the teams.
    pub input: &'a UtilityInput,
    /// Number of agents of each team, at least one.
    pub sizes: &'a [usize],
    /// Utility `[agents]` of every agent's chosen action.
    pub utilities: &'a [f32],
}

impl<'a> Teams<'a> {
    /// The agents of every team and their utilities.
    fn each(self) -> impl Iterator<Item = (Range<usize>, &'a [f32])> {
        let mut end = 0;
        self.sizes.iter().map(move |size| {
            let team = end..end + size;
            end = team.end;
            (team.clone(), &self.utilities[team])
        })
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct MixerPass {
    hypernetwork: HypernetworkPass,
    linear: Linear,
    qmix: Qmix,
    values: Vec<f32>,
    d_numbers: Vec<f32>,
}

impl MixerPass {
    /// Computes the value of every team.
    pub fn forward(&mut self, mixer: &Mixer, teams: Teams<'_>) -> &[f32] {
        let MixerShape { kind, mixing, .. } = mixer.shape;
        let values = sized(&mut self.values, teams.sizes.len());
        let (shape, parameters) = (mixer.shape.hypernetwork(), &mixer.parameters);
        match kind {
            MixerKind::Sum => {
                for ((_, utilities), value) in teams.each().zip(&mut *values) {
                    *value = utilities.iter().sum();
                }
            }
            MixerKind::Linear => {
                let numbers = self.hypernetwork.forward(shape, parameters, teams.input);
                self.linear.forward(teams, numbers, values);
            }
            MixerKind::Qmix => {
                let numbers = self.hypernetwork.forward(shape, parameters, teams.input);
                self.qmix.forward(mixing, teams, numbers, values);
            }
        }
        values
    }

    /// Writes the slope by every utility, and adds to `gradient` (all parameters), for a loss whose slope
    /// by the values of the last forward pass is `d_values`.
    pub fn backward(
        &mut self,
        mixer: &Mixer,
        teams: Teams<'_>,
        d_values: &[f32],
        d_utilities: &mut [f32],
        gradient: &mut [f32],
    ) {
        let shape = mixer.shape.hypernetwork();
        let d_numbers = sized(&mut self.d_numbers, teams.utilities.len() * shape.outputs);
        match mixer.shape.kind {
            MixerKind::Sum => {
                for ((team, _), d_value) in teams.each().zip(d_values) {
                    d_utilities[team].fill(*d_value);
                }
                return;
            }
            MixerKind::Linear => self.linear.backward(teams, d_values, d_utilities, d_numbers),
            MixerKind::Qmix => {
                let mixing = mixer.shape.mixing;
                self.qmix.backward(mixing, teams, d_values, d_utilities, d_numbers);
            }
        }
        self.hypernetwork.backward(shape, &mixer.parameters, teams.input, d_numbers, gradient);
    }
}

/// Numbers of the hypernetwork for each agent of the linear mixer.
const LINEAR_OUTPUTS: usize = 2;

/// The linear mixer (dissertation section 5.4.1): `Q = sum of w_a q_a + V`, with `w` a softmax over the team's agents of
/// the hypernetwork's first number and `V` the mean of its second over the team. Keeps the weights of all teams.
#[derive(Clone, Debug, Default)]
struct Linear {
    /// `[agents]`
    weights: Vec<f32>,
}

impl Linear {
    /// Writes the value of every team from the hypernetwork's `numbers [agents, 2]`.
    fn forward(&mut self, teams: Teams<'_>, numbers: &[f32], values: &mut [f32]) {
        let (numbers, _) = numbers.as_chunks::<LINEAR_OUTPUTS>();
        self.weights.clear();
        self.weights.extend(numbers.iter().map(|[score, _]| score));
        for ((team, utilities), value) in teams.each().zip(values) {
            let weights = &mut self.weights[team.clone()];
            softmax::forward(weights);
            let mixed: f32 = weights.iter().zip(utilities).map(|(w, q)| w * q).sum();
            let state: f32 = numbers[team].iter().map(|[_, state]| state).sum();
            *value = mixed + state / utilities.len() as f32;
        }
    }

    /// Writes the slopes by every utility and every number, after [`forward`](Self::forward).
    fn backward(
        &self,
        teams: Teams<'_>,
        d_values: &[f32],
        d_utilities: &mut [f32],
        d_numbers: &mut [f32],
    ) {
        let (d_numbers, _) = d_numbers.as_chunks_mut::<LINEAR_OUTPUTS>();
        for ((team, utilities), d_value) in teams.each().zip(d_values) {
            let weights = &self.weights[team.clone()];
            let mean: f32 = weights.iter().zip(utilities).map(|(w, q)| w * q).sum();
            let agents = d_utilities[team.clone()].iter_mut().zip(&mut d_numbers[team]);
            for ((weight, q), (d_utility, d_numbers)) in weights.iter().zip(utilities).zip(agents) {
                *d_utility = d_value * weight;
                // The softmax's slope, d_value * q being the slope by the weight.
                let d_score = d_value * weight * (q - mean);
                *d_numbers = [d_score, d_value / utilities.len() as f32];
            }
        }
    }
}

/// The same of QMIX, at a mixing width M.
fn qmix_outputs(mixing: usize) -> usize {
    3 * mixing + 1
}

/// The mixer of QMIX for teams of any size (dissertation section 5.3.2, per task section 7.3), with its layers of all teams
/// of the last forward pass.
///
/// `Q = w2 . elu(sum over agents of W1[a] q_a + b1) + V`. The hypernetwork gives each agent M numbers for its row of `W1`,
/// M for `b1`, M for `w2` and one for `V`; the last three are means over the team. Rows of `W1`, and `w2`, go through a
/// softmax, so that no weight is negative and a better utility never makes the team worse. `b1` and `V` are unrestricted.
#[derive(Clone, Debug, Default)]
struct Qmix {
    /// `W1 [agents, M]`, after its softmax.
    first: Vec<f32>,
    /// `[teams, M]`, after the elu.
    hidden: Vec<f32>,
    /// `w2 [teams, M]`, after its softmax.
    second: Vec<f32>,
    d_hidden: Vec<f32>,
    d_second: Vec<f32>,
}

impl Qmix {
    /// Writes the value of every team from the hypernetwork's `numbers [agents, 3 M + 1]`.
    fn forward(&mut self, mixing: usize, teams: Teams<'_>, numbers: &[f32], values: &mut [f32]) {
        let outputs = qmix_outputs(mixing);
        self.first.clear();
        for numbers in numbers.chunks_exact(outputs) {
            let start = self.first.len();
            self.first.extend_from_slice(&numbers[..mixing]);
            softmax::forward(&mut self.first[start..]);
        }
        self.hidden.clear();
        self.hidden.resize(teams.sizes.len() * mixing, 0.0);
        self.second.clear();
        self.second.resize(teams.sizes.len() * mixing, 0.0);

        let layers = self.hidden.chunks_exact_mut(mixing).zip(self.second.chunks_exact_mut(mixing));
        for (((team, utilities), value), (hidden, second)) in teams.each().zip(values).zip(layers) {
            let share = 1.0 / utilities.len() as f32;
            let first = self.first.chunks_exact(mixing).skip(team.start);
            let numbers = numbers.chunks_exact(outputs).skip(team.start);
            let mut state = 0.0;
            for ((utility, first), numbers) in utilities.iter().zip(first).zip(numbers) {
                add_scaled(hidden, *utility, first);
                add_scaled(hidden, share, &numbers[mixing..2 * mixing]);
                add_scaled(second, share, &numbers[2 * mixing..3 * mixing]);
                state += share * numbers[3 * mixing];
            }
            hidden.iter_mut().for_each(|x| *x = elu(*x));
            softmax::forward(second);
            *value = second.iter().zip(&*hidden).map(|(w, x)| w * x).sum::<f32>() + state;
        }
    }

    /// Writes the slopes by every utility and every number, after [`forward`](Self::forward).
    fn backward(
        &mut self,
        mixing: usize,
        teams: Teams<'_>,
        d_values: &[f32],
        d_utilities: &mut [f32],
        d_numbers: &mut [f32],
    ) {
        let outputs = qmix_outputs(mixing);
        let layers = self.hidden.chunks_exact(mixing).zip(self.second.chunks_exact(mixing));
        for (((team, utilities), d_value), (hidden, second)) in
            teams.each().zip(d_values).zip(layers)
        {
            self.d_second.clear();
            self.d_second.extend(hidden.iter().map(|x| d_value * x));
            softmax::backward(second, &mut self.d_second);
            self.d_hidden.clear();
            let slopes = second.iter().zip(hidden).map(|(w, x)| d_value * w * elu_slope(*x));
            self.d_hidden.extend(slopes);

            let share = 1.0 / utilities.len() as f32;
            let agents = d_utilities[team.clone()].iter_mut().zip(utilities);
            let first = self.first.chunks_exact(mixing).skip(team.start);
            let d_numbers = d_numbers.chunks_exact_mut(outputs).skip(team.start);
            for (((d_utility, utility), first), d_numbers) in agents.zip(first).zip(d_numbers) {
                *d_utility = first.iter().zip(&self.d_hidden).map(|(w, d)| w * d).sum();
                let (d_first, rest) = d_numbers.split_at_mut(mixing);
                let (d_bias, rest) = rest.split_at_mut(mixing);
                let (d_second, d_state) = rest.split_at_mut(mixing);
                set_scaled(d_first, *utility, &self.d_hidden);
                softmax::backward(first, d_first);
                set_scaled(d_bias, share, &self.d_hidden);
                set_scaled(d_second, share, &self.d_second);
                d_state.fill(share * d_value);
            }
        }
    }
}

fn elu(x: f32) -> f32 {
    if x > 0.0 { x } else { x.exp_m1() }
}

/// Its slope where it gave `y`.
fn elu_slope(y: f32) -> f32 {
    if y > 0.0 { 1.0 } else { y + 1.0 }
}

fn add_scaled(out: &mut [f32], factor: f32, values: &[f32]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += factor * value;
    }
}

fn set_scaled(out: &mut [f32], factor: f32, values: &[f32]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out = factor * value;
    }
}
