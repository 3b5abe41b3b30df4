//! Parts that configurations of several methods have in common.

use serde::{Deserialize, Serialize};
use sortie_nn::schedule::linear;

/// How much the agents try out: a random available action with probability epsilon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExplorationConfig {
    /// Epsilon of the first step.
    pub start: f32,
    /// Epsilon from step `steps` on.
    pub end: f32,
    /// Environment steps of the way down.
    pub steps: u64,
    /// Factors on epsilon, dealt to the instances in turn: some act greedily, some more wildly.
    pub spread: Vec<f32>,
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self { start: 1.0, end: 0.05, steps: 60_000, spread: vec![0.0, 0.2, 1.0, 2.0] }
    }
}

impl ExplorationConfig {
    /// Epsilon before the instances' factors, `step` environment steps into a run.
    pub fn epsilon_at(&self, step: u64) -> f32 {
        linear(self.start, self.end, self.steps, step)
    }
}

/// How the weights follow the gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Learning rate of Adam.
    pub learning_rate: f32,
    /// Learning rate at the end of the run.
    pub learning_rate_end: f32,
    /// Share of the run after which the learning rate goes to its end in a straight line.
    pub decay_from: f64,
    /// Added to Adam's denominator.
    pub epsilon: f32,
    /// Largest norm of the gradient.
    pub clip: f32,
    /// Share of the way that the target network moves towards the weights in an update.
    pub target_rate: f32,
    /// Share of the way that the averaged weights move, which are evaluated and shipped.
    pub average_rate: f32,
}

impl Default for OptimiserConfig {
    fn default() -> Self {
        Self {
            learning_rate: 1e-3,
            learning_rate_end: 0.0,
            decay_from: 0.5,
            epsilon: 1e-5,
            clip: 10.0,
            target_rate: 0.01,
            average_rate: 0.0005,
        }
    }
}

impl OptimiserConfig {
    /// The learning rate, `step` environment steps into a run of `steps`.
    pub fn learning_rate_at(&self, step: u64, steps: u64) -> f32 {
        let from = (self.decay_from * steps as f64) as u64;
        let (start, end) = (self.learning_rate, self.learning_rate_end);
        if step < from {
            return start;
        }
        linear(start, end, steps.saturating_sub(from), step.saturating_sub(from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learning_rate_stays_and_then_falls() {
        let optimiser = OptimiserConfig {
            learning_rate: 2.0,
            learning_rate_end: 1.0,
            decay_from: 0.5,
            ..OptimiserConfig::default()
        };
        let rates = [0, 50, 75, 100, 200].map(|step| optimiser.learning_rate_at(step, 100));
        assert_eq!(rates, [2.0, 2.0, 1.5, 1.0, 1.0]);
        let constant = OptimiserConfig { decay_from: 1.0, ..optimiser };
        assert_eq!([0, 50, 99].map(|step| constant.learning_rate_at(step, 100)), [2.0; 3]);
    }
}
