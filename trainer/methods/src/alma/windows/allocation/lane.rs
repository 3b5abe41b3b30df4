//! A lane's share of a step: what is computed row by row.

use std::ops::Range;

use super::critic::{CriticInput, CriticPass};
use super::decide::{AllocationNetworks, best_of, blocks, push_distinct};
use super::networks::AllocationCritic;
use super::proposals::ProposalPass;
use super::rows::Rows;
use super::{AllocationLearning, StepDraws};
use crate::alma::windows::{AllocationTimes, Stopwatch};

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

/// The last linear map of the critic: its weight and bias.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heads {
    /// The head whose outputs are compared with the targets.
    pub(super) compared: (f32, f32),
    /// The head through which the gradient goes.
    pub(super) gradient: (f32, f32),
}

/// Buffers of one lane and its results.
#[derive(Clone, Debug, Default)]
pub(super) struct Lane {
    proposals: ProposalPass,
    input: CriticInput,
    critic: CriticPass,
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
    operations: u64,
    /// Of all steps.
    pub(super) times: AllocationTimes,
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
        self.best.clear();
        self.values.clear();
        zero(&mut self.policy_gradient, networks.policy.parameters().len());
        (self.surprise, self.entropy) = (0.0, 0.0);
        let entropy_weight = (learning.entropy / loss.proposals) as f32;
        let mut watch = Stopwatch::start();
        for block in blocks(range) {
            let pass = &mut self.proposals;
            let sampling = (learning.proposals, draws.noise);
            let columns = &draws.proposals;
            pass.forward(networks.policy, states, block.clone(), &columns.policy, sampling);
            self.times.proposals += watch.lap();
            let valued = (&*pass, columns.critic.as_slice());
            push_distinct(&mut self.input, networks.critic, states, block.clone(), valued);
            let values = self.critic.forward(networks.critic, &self.input);

            let mut best = Vec::with_capacity(block.len());
            let found = best_of(pass, networks.critic, block.len(), values);
            for (whole, row) in found.into_iter().zip(block.clone()) {
                let start = self.best.len();
                self.best.resize(start + states.agents, 0);
                pass.write(whole, &mut self.best[start..]);
                self.surprise -= loss.policy[row] * f64::from(pass.log_probability(whole));
                best.push((whole, loss.policy[row] as f32));
            }
            self.entropy += pass.entropy();
            self.times.critic += watch.lap();
            pass.backward(networks.policy, &best, entropy_weight, &mut self.policy_gradient);
            self.times.policy += watch.lap();

            self.input.clear();
            let first = self.best.len() - block.len() * states.agents;
            let allocations = self.best[first..].chunks_exact(states.agents);
            for (row, allocation) in block.zip(allocations) {
                self.input.begin_state(states);
                self.input.push(target.shape(), states, row, allocation, &draws.target);
            }
            let values = self.critic.forward(target, &self.input);
            self.values.extend(values.iter().map(|raw| target.real(*raw)));
            self.times.critic += watch.lap();
        }
    }

    /// Compares the critic with normalised targets, and computes its gradient; `columns [T]` are its task
    /// columns.
    pub(super) fn value(
        &mut self,
        critic: &AllocationCritic,
        (rows, range): (&Rows, Range<usize>),
        loss: &Loss,
        (targets, columns): (&[f64], &[u8]),
        heads: Heads,
    ) {
        let mut watch = Stopwatch::start();
        let states = &rows.states;
        zero(&mut self.critic_gradient, critic.parameters().len());
        self.squared_error = 0.0;
        let (mut d_weight, mut d_bias) = (0.0, 0.0);
        for block in blocks(range) {
            // What does not count has no gradient either.
            let counts = |row: &usize| loss.critic.get(*row).is_some_and(|weight| *weight > 0.0);
            let counting: Vec<usize> = block.filter(counts).collect();
            self.input.clear();
            for row in &counting {
                self.input.begin_state(states);
                let allocation = states.allocation(*row);
                self.input.push(critic.shape(), states, *row, allocation, columns);
            }
            let raw = self.critic.forward(critic, &self.input);
            let mut slopes = Vec::with_capacity(counting.len());
            for (row, raw) in counting.iter().zip(raw) {
                let weight = loss.critic[*row];
                let normalised = heads.compared.0 * raw + heads.compared.1;
                let error = weight * (f64::from(normalised) - targets[*row]);
                self.squared_error += error * error;
                let slope = 2.0 * weight * error / loss.critic_total;
                d_weight += slope * f64::from(*raw);
                d_bias += slope;
                slopes.push(slope as f32 * heads.gradient.0);
            }
            self.critic.backward(critic, &self.input, &slopes, &mut self.critic_gradient);
        }
        let gradient = AllocationCritic::parts_of(critic.shape(), &mut self.critic_gradient);
        gradient.popart_weight[0] = d_weight as f32;
        gradient.popart_bias[0] = d_bias as f32;
        self.times.critic += watch.lap();
    }

    /// Floating-point operations since the last call.
    pub(super) fn take_operations(&mut self) -> u64 {
        let before = self.operations;
        self.operations = self.proposals.operations() + self.critic.operations;
        self.operations - before
    }
}

/// Makes a vector of so many zeros.
fn zero(vector: &mut Vec<f32>, length: usize) {
    vector.clear();
    vector.resize(length, 0.0);
}
