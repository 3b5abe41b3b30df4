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
use sortie_nn::tape::Tape;

use super::decide::{AllocationNetworks, best_of, blocks};
use super::networks::{AllocationCritic, AllocationPolicy, CriticInput};
use super::proposals::Proposals;
use super::rows::Rows;
use super::{AllocationLearning, StepDraws};
use crate::alma::windows::{Windows, add_up};

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
        Self {
            learning,
            optimisers: [&critic.parameters, &policy.parameters]
                .map(|parameters| RmsProp::new(parameters.values.len())),
            target: critic.clone(),
            critic,
            policy,
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
        rows.collect(windows, now, &self.learning.config);
        let loss = Loss::new(&rows, &self.learning);
        let step = |loss: &Loss| self.step(Step { rows: &rows, loss, draws }, threads);
        let report = loss.as_ref().map(step);
        self.last.rows = rows;
        report
    }

    fn step(&mut self, step: Step<'_>, threads: usize) -> AllocationReport {
        let (rows, count) = (step.rows, step.rows.len());
        let (learning, critic, policy) = (&self.learning, &self.critic, &self.policy);
        let networks = AllocationNetworks { policy, critic };
        in_lanes(threads, &mut self.lanes, |index, lane| {
            lane.propose(learning, networks, &self.target, step, lane_range(count, index));
        });

        self.last.best.clear();
        self.last.best.extend(self.lanes.iter().flat_map(|lane| lane.best.iter().copied()));
        self.find_targets(rows);
        let before = self.critic.head();
        let masked = self.last.targets.iter().zip(&rows.mask);
        let masked = masked.map(|(target, mask)| (*target, f64::from(u8::from(*mask))));
        let parameters = &mut self.critic.parameters.values[self.critic.layers.head_range()];
        self.critic.popart.update(masked, parameters);
        let popart = self.critic.popart;
        self.last.normalised.clear();
        self.last.normalised.extend(self.last.targets.iter().map(|y| popart.normalise(*y)));

        let after = self.critic.head();
        let compared = if self.learning.as_public_code { before } else { after };
        let (critic, targets) = (&self.critic, &self.last.normalised);
        in_lanes(threads, &mut self.lanes, |index, lane| {
            lane.value((critic, compared), targets, step, lane_range(count, index));
        });
        self.descend(rows, step.loss)
    }

    /// Adds up the lanes and moves both networks.
    fn descend(&mut self, rows: &Rows, loss: &Loss) -> AllocationReport {
        let LastStep { critic_gradient, policy_gradient, .. } = &mut self.last;
        add_up(self.lanes.iter().map(|lane| &lane.critic_gradient), critic_gradient);
        add_up(self.lanes.iter().map(|lane| &lane.policy_gradient), policy_gradient);
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
    fn find_targets(&mut self, rows: &Rows) {
        let discount = f64::from(self.learning.config.discount);
        let next = self.lanes.iter().flat_map(|lane| &lane.values).skip(1);
        let known = rows.reward.iter().zip(&rows.terminated).zip(next);
        self.last.targets.clear();
        self.last.targets.extend(known.map(|((reward, terminated), next)| {
            f64::from(*reward) + if *terminated { 0.0 } else { discount * next }
        }));
    }
}

fn lane_range(rows: usize, lane: usize) -> Range<usize> {
    rows * lane / LANES..rows * (lane + 1) / LANES
}

/// How rows count in the losses.
#[derive(Clone, Debug)]
struct Loss {
    /// For each row but the last, mask times age.
    critic: Vec<f64>,
    /// The sum of these.
    critic_total: f64,
    /// For each row its share of the policy's loss; they sum to 1.
    policy: Vec<f64>,
    /// Proposals of all rows.
    proposals: f64,
}

impl Loss {
    /// The weights of rows, or `None` where no row counts.
    fn new(rows: &Rows, learning: &AllocationLearning) -> Option<Self> {
        let mask = rows.mask.iter().map(|mask| f64::from(u8::from(*mask)));
        let aged = mask.zip(&rows.weight).map(|(mask, weight)| mask * f64::from(*weight));
        let mut policy: Vec<f64> = aged.collect();
        let critic = policy[..policy.len().checked_sub(1)?].to_vec();
        if learning.as_public_code {
            *policy.last_mut()? = f64::from(u8::from(*rows.mask.last()?));
        }
        let (critic_total, policy_total) = (critic.iter().sum::<f64>(), policy.iter().sum::<f64>());
        policy.iter_mut().for_each(|weight| *weight /= policy_total);
        let proposals = (rows.len() * learning.config.proposals) as f64;
        (critic_total > 0.0).then_some(Self { critic, critic_total, policy, proposals })
    }
}

/// What all lanes of a step read.
#[derive(Clone, Copy)]
struct Step<'a> {
    rows: &'a Rows,
    loss: &'a Loss,
    draws: &'a StepDraws<'a>,
}

/// Buffers of one lane and its results.
#[derive(Clone, Debug, Default)]
struct Lane {
    policy_tape: Tape,
    critic_tape: Tape,
    input: CriticInput,
    /// `[rows, A]`: the best proposals.
    best: Vec<u8>,
    /// What the target critic says of them, in real units.
    values: Vec<f64>,
    policy_gradient: Vec<f32>,
    critic_gradient: Vec<f32>,
    /// Sum of the weighted squared errors.
    squared_error: f64,
    /// Sum of `-log f` of the best proposals by their shares.
    surprise: f64,
    /// Sum of the entropies of all proposals.
    entropy: f64,
    operations: u64,
}

impl Lane {
    /// Finds and values the best proposals of some rows, and computes the policy's gradient.
    fn propose(
        &mut self,
        learning: &AllocationLearning,
        AllocationNetworks { policy, critic }: AllocationNetworks<'_>,
        target: &AllocationCritic,
        Step { rows: Rows { states, .. }, loss, draws }: Step<'_>,
        range: Range<usize>,
    ) {
        self.best.clear();
        self.values.clear();
        zero(&mut self.policy_gradient, policy.parameters.values.len());
        (self.surprise, self.entropy, self.operations) = (0.0, 0.0, 0);
        let entropy_weight = (f64::from(learning.config.entropy) / loss.proposals) as f32;
        for block in blocks(range) {
            let Self { policy_tape, critic_tape, input, .. } = self;
            let sampling = (learning.config.proposals, draws.noise);
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
    /// gradient.
    fn value(
        &mut self,
        (critic, compared): (&AllocationCritic, [f32; 2]),
        targets: &[f64],
        Step { rows: Rows { states, .. }, loss, draws }: Step<'_>,
        range: Range<usize>,
    ) {
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
            let (mut t, raw) = critic.value(critic_tape, input, (states, &draws.stored), stored);
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
