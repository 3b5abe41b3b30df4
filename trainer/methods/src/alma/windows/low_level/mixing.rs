//! The arithmetic of the mixer between its hypernetworks' numbers and the teams' values.

use sortie_nn::layers::{TeamLists, softmax};

use super::mixer_shape::{MixerShape, Nonnegative};

/// What the hypernetworks gave: `W1 [agents, M]`, `b1 [teams, M]`, `w2 [teams, M]`, `V [teams]`.
pub(super) struct Numbers<'a>(pub(super) [&'a [f32]; 4]);

/// The mixing layers of all teams of the last forward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct Mixing {
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
pub(super) struct MixingGradient {
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

/// The exponential linear unit.
fn elu(x: f32) -> f32 {
    if x > 0.0 { x } else { x.exp_m1() }
}

/// Its slope where it gave `y`.
fn elu_slope(y: f32) -> f32 {
    if y > 0.0 { 1.0 } else { y + 1.0 }
}
