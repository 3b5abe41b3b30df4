//! The high level as a whole: its networks and the steps that teach them.
//!
//! Amortised Q-learning (dissertation section 7.2.3 and the public code). Rows are shared out to a fixed
//! number of lanes, each with gradients of its own that are added in order: the result depends neither
//! on the number of threads nor on their timing.

use std::ops::Range;

use sortie_learn::random::{Purpose, generator};
use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::{RmsProp, clip_norm};
use sortie_nn::random::Generator;

use super::decide::AllocationNetworks;
use super::lane::{Lane, Loss};
use super::networks::{AllocationCritic, AllocationPolicy};
use super::rows::Rows;
use super::{AllocationLearning, StepDraws};
use crate::alma::windows::Windows;

/// Into how many parts the rows of a step are cut.
const LANES: usize = 8;

/// What one step found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AllocationReport {
    /// Decision points learned from.
    pub rows: usize,
    /// Weighted mean of the critic's squared errors, in normalised units.
    pub critic_loss: f64,
    /// Weighted mean of `-log f` of the best proposals.
    pub policy_loss: f64,
    /// Mean entropy of the proposals.
    pub entropy: f64,
    /// Norm of the critic's gradient before clipping.
    pub critic_norm: f32,
    /// Norm of the policy's gradient before clipping.
    pub policy_norm: f32,
    /// Floating-point operations, of matrix products and attention only.
    pub operations: u64,
}

/// What the last step was computed from, for inspection. Rows are decision points.
#[derive(Clone, Debug, Default)]
pub struct LastStep {
    /// The rows.
    pub rows: Rows,
    /// Targets in real units, of all rows but the last.
    pub targets: Vec<f64>,
    /// The same in normalised units.
    pub normalised: Vec<f64>,
    /// `[rows, A]`: the best proposals.
    pub best: Vec<u8>,
    /// The critic's gradient, clipped.
    pub critic_gradient: Vec<f32>,
    /// The policy's gradient, clipped.
    pub policy_gradient: Vec<f32>,
}

/// Critic, policy, target critic, optimisers, and the buffers of a step. All state is open, to be saved and restored.
#[derive(Clone, Debug)]
pub struct AllocationLevel {
    /// How it learns.
    pub learning: AllocationLearning,
    /// Values allocations.
    pub critic: AllocationCritic,
    /// Proposes some.
    pub policy: AllocationPolicy,
    /// Values what comes next. The public code copies the policy too, and never uses the copy.
    pub target: AllocationCritic,
    /// The optimisers of critic and policy.
    pub optimisers: [RmsProp; 2],
    lanes: Vec<Lane>,
    /// What the last step was computed from.
    pub last: LastStep,
}

impl AllocationLevel {
    /// Networks with random weights that have learned nothing.
    pub fn new(learning: AllocationLearning, seed: u64) -> Self {
        let random = |index| generator(seed, Purpose::Weights, index);
        // The low level draws its weights from the streams before these.
        let critic = AllocationCritic::initialise(learning.shape, &mut random(16));
        let policy = AllocationPolicy::initialise(learning.shape, &mut random(17));
        Self::with_networks(learning, critic.clone(), policy, critic)
    }

    /// Given networks and optimisers that have taken no step.
    pub fn with_networks(
        learning: AllocationLearning,
        critic: AllocationCritic,
        policy: AllocationPolicy,
        target: AllocationCritic,
    ) -> Self {
        Self {
            learning,
            optimisers: [&critic.parameters, &policy.parameters]
                .map(|parameters| RmsProp::new(parameters.values.len())),
            critic,
            policy,
            target,
            lanes: vec![Lane::default(); LANES],
            last: LastStep::default(),
        }
    }

    /// The networks that decide.
    pub fn networks(&self) -> AllocationNetworks<'_> {
        AllocationNetworks { policy: &self.policy, critic: &self.critic }
    }

    /// Lets the target critic be what the critic is.
    pub fn copy_target(&mut self) {
        self.target.clone_from(&self.critic);
    }

    /// Takes one step on both networks, `now` environment steps into the run.
    ///
    /// Changes nothing and gives `None` where the windows hold nothing to learn from.
    pub fn learn(
        &mut self,
        windows: &Windows,
        now: u64,
        generator: &mut Generator,
        threads: usize,
    ) -> Option<AllocationReport> {
        let (tasks, columns) = (windows.shape.tasks, self.learning.shape.columns);
        let draws = StepDraws::draw(tasks, columns, generator);
        self.learn_with(windows, now, &draws, threads)
    }

    /// As [`learn`](Self::learn), with the random choices given.
    pub fn learn_with(
        &mut self,
        windows: &Windows,
        now: u64,
        draws: &StepDraws<'_>,
        threads: usize,
    ) -> Option<AllocationReport> {
        let mut rows = std::mem::take(&mut self.last.rows);
        rows.collect(windows, now, &self.learning.rows);
        let loss = Loss::new(&rows, &self.learning);
        let report = loss.map(|loss| self.step(&rows, &loss, draws, threads));
        self.last.rows = rows;
        report
    }

    fn step(
        &mut self,
        rows: &Rows,
        loss: &Loss,
        draws: &StepDraws<'_>,
        threads: usize,
    ) -> AllocationReport {
        let count = rows.len();
        let (learning, critic, policy) = (&self.learning, &self.critic, &self.policy);
        let networks = AllocationNetworks { policy, critic };
        in_lanes(threads, &mut self.lanes, |index, lane| {
            let range = lane_range(count, index);
            lane.propose(networks, &self.target, (rows, range), loss, draws, learning);
        });

        self.last.best.clear();
        self.last.best.extend(self.lanes.iter().flat_map(|lane| lane.best.iter().copied()));
        let next: Vec<f64> =
            self.lanes.iter().flat_map(|lane| lane.values.iter().copied()).collect();
        self.find_targets(rows, &next);
        let before = self.critic.head();
        let masked = self.last.targets.iter().zip(&rows.mask);
        let masked = masked.map(|(target, mask)| (*target, f64::from(u8::from(*mask))));
        let rescale = self.critic.popart.update(masked);
        let (weights, biases) = self.critic.head_mut();
        rescale.apply(weights, biases);
        let popart = self.critic.popart;
        self.last.normalised.clear();
        self.last.normalised.extend(self.last.targets.iter().map(|y| popart.normalise(*y)));

        let after = self.critic.head();
        let compared = if self.learning.as_public_code { before } else { after };
        let (critic, targets) = (&self.critic, &self.last.normalised);
        in_lanes(threads, &mut self.lanes, |index, lane| {
            let range = lane_range(count, index);
            lane.value((critic, compared), (rows, range), loss, (targets, &draws.stored));
        });
        self.descend(rows, loss)
    }

    /// Adds up the lanes and moves both networks.
    fn descend(&mut self, rows: &Rows, loss: &Loss) -> AllocationReport {
        let LastStep { critic_gradient, policy_gradient, .. } = &mut self.last;
        sum_into(critic_gradient, self.lanes.iter().map(|lane| &lane.critic_gradient));
        sum_into(policy_gradient, self.lanes.iter().map(|lane| &lane.policy_gradient));
        let limit = self.learning.gradient_norm;
        let critic_norm = clip_norm(critic_gradient, limit);
        let policy_norm = clip_norm(policy_gradient, limit);
        let rate = self.learning.learning_rate;
        let [of_critic, of_policy] = &mut self.optimisers;
        of_critic.step(&mut self.critic.parameters.values, critic_gradient, rate);
        of_policy.step(&mut self.policy.parameters.values, policy_gradient, rate);
        let sum = |of: fn(&Lane) -> f64| self.lanes.iter().map(of).sum::<f64>();
        AllocationReport {
            rows: rows.len(),
            critic_loss: sum(|lane| lane.squared_error) / loss.critic_total,
            policy_loss: sum(|lane| lane.surprise),
            entropy: sum(|lane| lane.entropy) / loss.proposals,
            critic_norm,
            policy_norm,
            operations: self.lanes.iter().map(|lane| lane.operations).sum(),
        }
    }

    /// `R + γ (1 - term) Q(s', b*')` of all rows but the last.
    fn find_targets(&mut self, rows: &Rows, next: &[f64]) {
        let discount = self.learning.discount;
        let known = rows.reward.iter().zip(&rows.terminated).zip(&next[1..]);
        self.last.targets.clear();
        self.last.targets.extend(known.map(|((reward, terminated), next)| {
            f64::from(*reward) + if *terminated { 0.0 } else { discount * next }
        }));
    }
}

fn lane_range(rows: usize, lane: usize) -> Range<usize> {
    rows * lane / LANES..rows * (lane + 1) / LANES
}

fn sum_into<'a>(sum: &mut Vec<f32>, parts: impl Iterator<Item = &'a Vec<f32>>) {
    sum.clear();
    for part in parts {
        sum.resize(part.len(), 0.0);
        sum.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
    }
}
