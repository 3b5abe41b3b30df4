//! The linear mixer (dissertation section 5.4.1): a weighted sum of utilities and a value of the state.
//!
//! `Q = sum of w_a q_a + V`, with `w` a softmax over the team's agents of the hypernetwork's first number
//! and `V` the mean of its second over the team.

use sortie_nn::layers::softmax;

use super::Teams;

/// Numbers of the hypernetwork for each agent.
pub(super) const OUTPUTS: usize = 2;

/// Space for the weights of all teams.
#[derive(Clone, Debug, Default)]
pub(super) struct Linear {
    /// `[agents]`
    weights: Vec<f32>,
}

impl Linear {
    /// Writes the value of every team from the hypernetwork's `numbers [agents, 2]`.
    pub(super) fn forward(&mut self, teams: Teams<'_>, numbers: &[f32], values: &mut [f32]) {
        let (numbers, _) = numbers.as_chunks::<OUTPUTS>();
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
    pub(super) fn backward(
        &self,
        teams: Teams<'_>,
        d_values: &[f32],
        d_utilities: &mut [f32],
        d_numbers: &mut [f32],
    ) {
        let (d_numbers, _) = d_numbers.as_chunks_mut::<OUTPUTS>();
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
