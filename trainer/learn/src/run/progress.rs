//! How a run goes, for whoever watches it, also between two evaluations.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::counters::{EpisodeCounts, Window};
use super::{Counters, CurvePoint, Rates, RunResult};

/// How far a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// Environment steps taken.
    pub env_steps: u64,
    /// Environment steps of the whole run.
    pub of: u64,
}

/// Is told how a run goes.
pub trait Observer {
    /// Some steps were taken; called several hundred times a second.
    fn progress(&mut self, _now: Now) {}

    /// Training went on for a while.
    fn trained(&mut self, _point: &TrainingPoint) {}

    /// An evaluation was made.
    fn evaluated(&mut self, _point: &CurvePoint) {}

    /// A checkpoint was written.
    fn saved(&mut self, _checkpoint: &Path) {}

    /// The run has ended and was measured on fresh episodes.
    fn finished(&mut self, _result: &RunResult) {}
}

/// Listens to nothing.
impl Observer for () {}

/// How a trainer ended its work for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps were taken.
    Finished,
    /// The stop flag was set; a checkpoint was written.
    Stopped,
}

/// Points from one evaluation to the next.
const POINTS: u64 = 25;

/// What training did since the point before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrainingPoint {
    /// Environment steps taken.
    pub env_steps: u64,
    /// Environment steps a second, evaluations left out.
    pub steps_per_second: f64,
    /// Mean return of the exploring episodes that ended.
    pub return_mean: Option<f64>,
    /// Share of those episodes that were solved.
    pub success: Option<f64>,
    /// Mean loss of the agents' updates.
    pub loss: Option<f64>,
    /// Mean loss of the allocator's updates.
    pub allocator_loss: Option<f64>,
    /// Exploration, before the instances' factors.
    pub epsilon: f32,
    /// Learning rate of the agents.
    pub learning_rate: f32,
}

/// Makes a point every so many steps.
#[derive(Debug)]
pub(crate) struct Meter {
    every: u64,
    /// Where the last point was.
    env_steps: u64,
    window: Window,
    since: Instant,
}

impl Meter {
    pub(crate) fn new(evaluate_every: u64, counters: &Counters) -> Self {
        Self {
            every: (evaluate_every / POINTS).max(1),
            env_steps: counters.env_steps,
            window: counters.window,
            since: Instant::now(),
        }
    }

    /// Goes on from here: what happened meanwhile was no training.
    pub(crate) fn restart(&mut self, counters: &Counters) {
        *self = Self { every: self.every, ..Self::new(1, counters) };
    }

    /// A point, where one is due.
    pub(crate) fn measure(&mut self, counters: &Counters, rates: Rates) -> Option<TrainingPoint> {
        let steps = counters.env_steps - self.env_steps;
        if steps < self.every {
            return None;
        }
        let (now, before) = (&counters.window, &self.window);
        let share = |sum: fn(&EpisodeCounts) -> f64| {
            let episodes = now.episodes.episodes - before.episodes.episodes;
            (episodes > 0).then(|| (sum(&now.episodes) - sum(&before.episodes)) / episodes as f64)
        };
        let point = TrainingPoint {
            env_steps: counters.env_steps,
            steps_per_second: steps as f64 / self.since.elapsed().as_secs_f64().max(1e-9),
            return_mean: share(|episodes| episodes.return_sum),
            success: share(|episodes| episodes.solved as f64),
            loss: now.agents.mean_loss_since(&before.agents),
            allocator_loss: now.allocator.mean_loss_since(&before.allocator),
            epsilon: rates.epsilon,
            learning_rate: rates.learning_rate,
        };
        self.restart(counters);
        Some(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::UpdateReport;

    #[test]
    fn a_point_tells_what_happened_since_the_one_before() {
        let rates = Rates { epsilon: 0.5, learning_rate: 0.1 };
        let mut counters = Counters::new(250);
        let mut meter = Meter::new(250, &counters);
        counters.env_steps = 9;
        assert_eq!(meter.measure(&counters, rates), None);
        for (loss, earned) in [(1.0, 2.0), (5.0, 8.0)] {
            counters.env_steps += 10;
            counters.window.agents.add(UpdateReport { loss, gradient_norm: 0.0 });
            counters.window.episodes.episodes += 2;
            counters.window.episodes.return_sum += earned;
            let point = meter.measure(&counters, rates).expect("a point is due");
            assert_eq!((point.loss, point.return_mean), (Some(loss), Some(earned / 2.0)));
            assert_eq!((point.success, point.allocator_loss), (Some(0.0), None));
            assert!(point.steps_per_second > 0.0);
        }
        counters.window = Window::default();
        meter.restart(&counters);
        counters.env_steps += 10;
        assert_eq!(meter.measure(&counters, rates).unwrap().return_mean, None);
    }
}
