//! The mixer of QMIX for teams of any size (dissertation section 5.3.2, per task section 7.3).
//!
//! `Q = w2 . elu(sum over agents of W1[a] q_a + b1) + V`. The hypernetwork gives each agent M numbers for
//! its row of `W1`, M for `b1`, M for `w2` and one for `V`; the last three are means over the team.
//! Rows of `W1`, and `w2`, go through a softmax, so that no weight is negative and a better utility
//! never makes the team worse. `b1` and `V` are unrestricted.

use sortie_nn::layers::softmax;

use super::Teams;

/// Numbers of the hypernetwork for each agent, at a mixing width M.
pub(super) fn outputs(mixing: usize) -> usize {
    3 * mixing + 1
}

/// The mixing layers of all teams of the last forward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct Qmix {
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
    pub(super) fn forward(
        &mut self,
        mixing: usize,
        teams: Teams<'_>,
        numbers: &[f32],
        values: &mut [f32],
    ) {
        let outputs = outputs(mixing);
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
    pub(super) fn backward(
        &mut self,
        mixing: usize,
        teams: Teams<'_>,
        d_values: &[f32],
        d_utilities: &mut [f32],
        d_numbers: &mut [f32],
    ) {
        let outputs = outputs(mixing);
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

/// The exponential linear unit.
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
