//! A deep Q-network without goals (Mnih et al. 2015): what HAL is compared with (Rainbow of dissertation chapter 6).
//!
//! It learns the values of actions alone, and is paid for what it reaches.

mod method;
mod returns;

use sortie_learn::configuration::Range::{Numbers, OneOf, Truth, Whole};
use sortie_learn::configuration::{OPTIMISER, OptimiserConfig, SHARE};
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method, Now, sections};
use sortie_nn::schedule::linear;

use crate::options::{
    Chances, REPLAY, WEIGHTS, fast_optimiser, fast_setup, learned_as, misfit, paper_optimiser,
    paper_setup,
};
use returns::PayRules;

pub use crate::options::{ReplayConfig, WeightsConfig};
pub use crate::pictures::Body;
pub use method::Dqn;

sections! {
    /// Sizes, chances and rates; the default is the preset `fast`.
    Config, KEYS;

    /// What the network is shown, and how wide it is.
    network: NetworkConfig {
        /// Two layers over sparse inputs, or convolutions over the picture as published.
        body: Body = Body::Layers, OneOf(Body::WORDS);
        /// Cells around the agent, each way across, that are shown one by one; odd.
        crop: usize = 5, Whole(1, 15), "cells";
        /// Whether the nearest cell of every kind is shown.
        nearest: bool = true, Truth;
        /// Width of the hidden layers, a multiple of 8.
        width: usize = 64, Whole(8, 1024), "columns";
        /// Inputs that differ from zero, which the first weights are sized for.
        active_inputs: usize = 30, Whole(1, 4096), "columns";
    }

    /// What is paid for, and how it becomes targets.
    returns: ReturnsConfig {
        /// Whether every milestone is paid for when an episode first reaches it, all of them together 1; the task alone, 1,
        /// otherwise.
        milestones: bool = true, Truth;
        /// Steps before a target bootstraps.
        steps: u8 = 3, Whole(1, 254), "steps";
        /// Worth of a reward one step later.
        discount: f32 = 0.97, SHARE, "factor per step";
        /// What a step costs.
        cost: f32 = 0.0, SHARE, "reward";
        /// Whether rewards are learned as `sign(r) log2(1 + abs(r))`.
        logarithm: bool = false, Truth;
        /// Whether values that are looked up are held between 0 and 1.
        bounded: bool = true, Truth;
        /// Whether steps behind which time was over, or nothing could be reached any more, are learned from.
        time_outs: bool = true, Truth;
        /// From one copy of the weights to those that targets are computed by to the next; 0 moves these by
        /// `optimiser.target_rate` in every update.
        target_every: u64 = 0, Whole(0, 20_000_000), "updates";
        /// Whether actions that change nothing are worth nothing.
        no_operations: bool = true, Truth;
        /// Whether states are shown left for right half of the time.
        mirror: bool = true, Truth;
    }

    /// How much is tried out.
    exploration: ExplorationConfig {
        /// In which all actions are drawn.
        first: u64 = 6_400, Whole(0, 20_000_000), "environment steps";
        /// Over which the chance changes.
        share: f64 = 0.8, SHARE, "share of the run";
        /// Of a random action: from the first chance to the second in a straight line.
        actions: [f32; 2] = [0.5, 0.05], Numbers(0.0, 1.0), "probability";
    }

    /// How much of chance is left where agents are measured.
    measured: MeasuredConfig {
        /// Of a random action.
        actions: f32 = 0.05, SHARE, "probability";
        /// Whether a view that is met again since the last milestone is answered by the next best action.
        varied: bool = true, Truth;
    }

    /// What is kept, and how much of it an update sees.
    replay: ReplayConfig = ReplayConfig::default(), REPLAY;
    /// What keeps weights small.
    weights: WeightsConfig = WeightsConfig::default(), WEIGHTS;
    /// How the weights follow the gradient.
    optimiser: OptimiserConfig = OptimiserConfig::default(), OPTIMISER;
}

impl MeasuredConfig {
    fn chances(&self) -> Chances<'static> {
        let Self { actions, varied } = *self;
        Chances { actions, goals: 0.0, afforded: 0.0, reached: &[], varied }
    }
}

impl ReturnsConfig {
    /// Of an environment with so many milestones, the last of which is the task.
    fn rules(&self, milestones: usize) -> PayRules {
        let Self { steps, discount, no_operations, time_outs, cost, .. } = *self;
        let pay = if self.milestones { 1.0 / milestones as f32 } else { 1.0 };
        let [paid, cost] = [pay - cost, cost].map(|reward| learned_as(reward, self.logarithm));
        let (task, task_alone) = (milestones as u8 - 1, !self.milestones);
        PayRules { steps, discount, no_operations, time_outs, paid, cost, task, task_alone }
    }
}

impl ExplorationConfig {
    /// The chance of a random action.
    fn actions_at(&self, now: Now) -> f32 {
        let ([start, end], over) = (self.actions, self.share * now.of as f64);
        if now.env_steps < self.first {
            1.0
        } else {
            linear(start, end, over as u64, now.env_steps)
        }
    }
}

impl Config {
    /// The published settings of the iron task (dissertation chapter 6 and the public code).
    fn paper() -> Self {
        let usual = Self::default();
        Self {
            network: NetworkConfig {
                body: Body::Convolution,
                crop: 11,
                nearest: false,
                width: 512,
                ..usual.network
            },
            returns: ReturnsConfig {
                steps: 10,
                discount: 0.99,
                cost: 0.01,
                logarithm: true,
                bounded: false,
                time_outs: false,
                target_every: 10_000,
                no_operations: false,
                mirror: false,
                ..usual.returns
            },
            replay: ReplayConfig::paper(),
            exploration: ExplorationConfig { first: 400, ..usual.exploration },
            measured: MeasuredConfig { varied: false, ..usual.measured },
            weights: WeightsConfig { decay: 1e-5 },
            optimiser: paper_optimiser(),
        }
    }
}

/// An agent without goals.
pub const DQN: MethodEntry = MethodEntry {
    name: "dqn",
    about: "An agent without goals that is paid for the milestones it reaches (Rainbow in dissertation chapter 6)",
    keys: |_| KEYS,
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: paper }],
    flags: &[],
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

fn fast() -> Setup {
    fast_setup(&Config { optimiser: fast_optimiser(), ..Config::default() })
}

fn paper() -> Setup {
    paper_setup(&Config::paper())
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    Ok(Box::new(Dqn::new(opening.setup.own()?, opening)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_paid_is_shared_by_all_milestones_or_the_task_has_it() {
        let returns = Config::default().returns;
        assert_eq!((returns.rules(11).paid, returns.rules(11).cost), (1.0 / 11.0, 0.0));
        let paper = Config::paper().returns;
        let rules = paper.rules(11);
        assert!((rules.paid - (1.0 + 1.0 / 11.0 - 0.01_f32).log2()).abs() < 1e-6);
        assert!((rules.cost - 0.014355).abs() < 1e-6 && !rules.task_alone && rules.task == 10);
        let alone = ReturnsConfig { milestones: false, ..paper }.rules(11);
        assert!((alone.paid - 0.99277).abs() < 1e-5 && alone.task_alone);
    }
}
