//! A lane's share of a step: what is computed row by row.

use std::ops::Range;

use sortie_nn::tape::Tape;

use super::critic::CriticInput;
use super::decide::{AllocationNetworks, best_of, blocks};
use super::networks::AllocationCritic;
use super::proposals::Proposals;
use super::rows::Rows;
use super::{AllocationLearning, StepDraws};

/// How rows count in the losses.
#[derive(Clone, Debug)]
pub(super) struct Loss {
    /// For each row but the last, mask times age.
    critic: Vec<f64>,
    /// The sum of these.
    pub(super) critic_total: f64,
    /// For each row its share of the policy's loss; they sum to 1.
    policy: Vec<f64>,
    /// Proposals of all rows.
    pub(super) proposals: f64,
}

impl Loss {
    /// The weights of rows, or `None` where no row counts.
    pub(super) fn new(rows: &Rows, learning: &AllocationLearning) -> Option<Self> {
        let mask = rows.mask.iter().map(|mask| f64::from(u8::from(*mask)));
        let mut policy: Vec<f64> = mask
            .clone()
            .zip(&rows.weight)
            .map(|(mask, weight)| mask * f64::from(*weight))
            .collect();
        let critic = policy[..policy.len().checked_sub(1)?].to_vec();
        if learning.as_public_code {
            *policy.last_mut()? = f64::from(u8::from(*rows.mask.last()?));
        }
        let (critic_total, policy_total) = (critic.iter().sum::<f64>(), policy.iter().sum::<f64>());
        policy.iter_mut().for_each(|weight| *weight /= policy_total);
        let proposals = (rows.len() * learning.proposals) as f64;
        (critic_total > 0.0).then_some(Self { critic, critic_total, policy, proposals })
    }
}

/// Buffers of one lane and its results.
#[derive(Debug, Default)]
pub(super) struct Lane {
    policy_tape: Tape,
    critic_tape: Tape,
    input: CriticInput,
    /// `[rows, A]`: the best proposals.
    pub(super) best: Vec<u8>,
    /// What the target critic says of them, in real units.
    pub(super) values: Vec<f64>,
    pub(super) policy_gradient: Vec<f32>,
    pub(super) critic_gradient: Vec<f32>,
    /// Sum of the weighted squared errors.
    pub(super) squared_error: f64,
    /// Sum of `-log f` of the best proposals by their shares.
    pub(super) surprise: f64,
    /// Sum of the entropies of all proposals.
    pub(super) entropy: f64,
    /// Floating-point operations of the step.
    pub(super) operations: u64,
}

impl Clone for Lane {
    /// A lane of its own: what lanes hold is forgotten in the next step.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Lane {
    /// Finds and values the best proposals of some rows, and computes the policy's gradient.
    pub(super) fn propose(
        &mut self,
        networks: AllocationNetworks<'_>,
        target: &AllocationCritic,
        (rows, range): (&Rows, Range<usize>),
        loss: &Loss,
        draws: &StepDraws<'_>,
        learning: &AllocationLearning,
    ) {
        let states = &rows.states;
        let AllocationNetworks { policy, critic } = networks;
        self.best.clear();
        self.values.clear();
        zero(&mut self.policy_gradient, policy.parameters.values.len());
        (self.surprise, self.entropy, self.operations) = (0.0, 0.0, 0);
        let entropy_weight = (learning.entropy / loss.proposals) as f32;
        for block in blocks(range) {
            let Self { policy_tape, critic_tape, input, .. } = self;
            let sampling = (learning.proposals, draws.noise);
            let own = (states, block.clone());
            let columns = &draws.proposals;
            let mut proposals =
                Proposals::draw(policy_tape, policy, own, &columns.policy, sampling);
            let own = (states, &*columns.critic);
            let (t, values) = critic.value(critic_tape, input, own, proposals.distinct());
            let found = best_of(&proposals, critic, t.values(values));
            self.operations += t.operations(false);

            let mut best = Vec::with_capacity(block.len());
            for (whole, row) in found.into_iter().zip(block.clone()) {
                proposals.write(whole, &mut self.best);
                self.surprise -= loss.policy[row] * f64::from(proposals.log_probability(whole));
                best.push((whole, loss.policy[row] as f32));
            }
            self.entropy += proposals.entropy();
            proposals.descend(&best, entropy_weight, &mut self.policy_gradient);
            self.operations += proposals.t.operations(true);

            let first = self.best.len() - block.len() * states.agents;
            let best = block.zip(self.best[first..].chunks_exact(states.agents));
            let (t, values) = target.value(critic_tape, input, (states, &draws.target), best);
            self.values.extend(t.values(values).iter().map(|raw| target.real(*raw)));
            self.operations += t.operations(false);
        }
    }

    /// Compares the critic, whose outputs go through the head `compared`, with normalised targets, and computes its
    /// gradient; `columns [T]` are its task columns.
    pub(super) fn value(
        &mut self,
        (critic, compared): (&AllocationCritic, [f32; 2]),
        (rows, range): (&Rows, Range<usize>),
        loss: &Loss,
        (targets, columns): (&[f64], &[u8]),
    ) {
        let states = &rows.states;
        zero(&mut self.critic_gradient, critic.parameters.values.len());
        self.squared_error = 0.0;
        for block in blocks(range) {
            // What does not count has no gradient either.
            let counts = |row: &usize| loss.critic.get(*row).is_some_and(|weight| *weight > 0.0);
            let counting: Vec<usize> = block.filter(counts).collect();
            if counting.is_empty() {
                continue;
            }
            let stored = counting.iter().map(|row| (*row, states.allocation(*row)));
            let Self { critic_tape, input, .. } = self;
            let (mut t, raw) = critic.value(critic_tape, input, (states, columns), stored);
            let mut slopes = Vec::with_capacity(counting.len());
            for (row, raw) in counting.iter().zip(t.values(raw)) {
                let weight = loss.critic[*row];
                let normalised = compared[0] * raw + compared[1];
                let error = weight * (f64::from(normalised) - targets[*row]);
                self.squared_error += error * error;
                slopes.push((2.0 * weight * error / loss.critic_total) as f32);
            }
            let values = critic.layers.head(&mut t, raw);
            let loss = t.weighted_sum(values, &slopes);
            t.backward(loss, &mut self.critic_gradient);
            self.operations += t.operations(true);
        }
    }
}

/// Makes a vector of so many zeros.
fn zero(vector: &mut Vec<f32>, length: usize) {
    vector.clear();
    vector.resize(length, 0.0);
}
