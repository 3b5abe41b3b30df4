//! What a run counts, and the time that it takes.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

use super::curve::{CurvePoint, read_lines, write_lines};
use crate::error::{LearnError, Result};
use crate::evaluate::Evaluation;

/// How the agents try out and learn.
#[derive(Clone, Copy, Debug)]
pub struct Rates {
    /// Chance of a random action, before factors of instances.
    pub epsilon: f32,
    /// Step size of the optimiser.
    pub learning_rate: f32,
}

/// One value for the agents and one for the allocator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Level<T> {
    /// Of the agents.
    pub agents: T,
    /// Of what allocates them.
    pub allocator: T,
}

/// What one update found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UpdateReport {
    /// Mean squared error of the batch.
    pub loss: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f32,
}

/// What a method did since it was asked last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reports {
    /// The updates of the agents.
    pub agents: Vec<UpdateReport>,
    /// The updates of what allocates them.
    pub allocator: Vec<UpdateReport>,
    /// How often agents were allocated.
    pub decisions: u64,
}

/// Episodes that ended during some steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeCounts {
    /// Episodes that ended.
    pub episodes: u64,
    /// Those that were solved.
    pub solved: u64,
    /// Those that timed out.
    pub timed_out: u64,
    /// Sum of the team's rewards.
    pub return_sum: f64,
    /// Decisions of the allocator.
    pub decisions: u64,
}

/// Sums over the updates since the last evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Updates {
    pub(crate) updates: u64,
    loss: f64,
    gradient_norm: f64,
}

impl Updates {
    pub(crate) fn add(&mut self, report: UpdateReport) {
        self.updates += 1;
        self.loss += report.loss;
        self.gradient_norm += f64::from(report.gradient_norm);
    }

    /// Mean loss of the updates after `before`, if there were any.
    pub(crate) fn mean_loss_since(&self, before: &Self) -> Option<f64> {
        let updates = self.updates - before.updates;
        (updates > 0).then(|| (self.loss - before.loss) / updates as f64)
    }

    fn mean_loss(&self) -> f64 {
        self.loss / self.updates.max(1) as f64
    }

    fn mean_gradient_norm(&self) -> f64 {
        self.gradient_norm / self.updates.max(1) as f64
    }
}

/// What happened since the last evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Window {
    pub(crate) agents: Updates,
    pub(crate) allocator: Updates,
    /// Those that ended.
    pub(crate) episodes: EpisodeCounts,
}

impl Window {
    /// Adds what a method did, unless a loss is no number any more: then nothing can be learned from here on.
    pub(crate) fn add(&mut self, reports: Reports, env_steps: u64) -> Result<()> {
        let agents = ("agents", reports.agents, &mut self.agents);
        let allocator = ("allocator", reports.allocator, &mut self.allocator);
        for (level, reports, updates) in [agents, allocator] {
            for report in reports {
                let loss = report.loss;
                if !loss.is_finite() {
                    return Err(LearnError::Diverged { level, env_steps, loss });
                }
                updates.add(report);
            }
        }
        self.episodes.decisions += reports.decisions;
        Ok(())
    }
}

/// Where a run is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Counters {
    pub(crate) env_steps: u64,
    /// Optimiser steps before the window.
    pub(crate) updates: Level<u64>,
    /// Decisions before the window.
    pub(crate) decisions: u64,
    pub(crate) next_evaluation: u64,
    /// Seconds since the run began, interruptions left out.
    pub(crate) wall_s: f64,
    pub(crate) cpu_s: f64,
    pub(crate) window: Window,
    /// The evaluations, as lines of text: a form that describes itself holds metrics of any name.
    #[serde(serialize_with = "write_lines", deserialize_with = "read_lines")]
    pub(crate) curve: Vec<CurvePoint>,
}

impl Counters {
    /// A run that has not begun, with its first evaluation after so many steps.
    pub(crate) fn new(evaluate_every: u64) -> Self {
        Self { next_evaluation: evaluate_every, ..Self::default() }
    }

    /// Environment steps that a run comes to: all of them, or as many as so many processor seconds are enough for, as far as
    /// can be told from those that were taken; 0 seconds: all.
    pub(crate) fn steps_in_all(&self, steps: u64, cpu_s: f64) -> u64 {
        if cpu_s == 0.0 || self.env_steps == 0 || self.cpu_s == 0.0 {
            return steps;
        }
        let in_time = self.env_steps as f64 * (cpu_s / self.cpu_s);
        steps.min((in_time as u64).max(self.env_steps))
    }

    /// Counts the time since the clock was read last.
    pub(crate) fn add_time(&mut self, clock: &mut Clock) {
        let now = Clock::start();
        self.wall_s += (now.wall - clock.wall).as_secs_f64();
        self.cpu_s += now.cpu_s - clock.cpu_s;
        *clock = now;
    }

    /// A point of the curve: an evaluation, and what happened since the one before.
    pub(crate) fn point(
        &self,
        result: &Evaluation,
        allocation: String,
        rates: Rates,
    ) -> CurvePoint {
        let Self { env_steps, updates, decisions, wall_s, cpu_s, window, .. } = self;
        let episodes = &window.episodes;
        CurvePoint {
            env_steps: *env_steps,
            updates: updates.agents + window.agents.updates,
            decisions: decisions + episodes.decisions,
            wall_s: *wall_s,
            cpu_s: *cpu_s,
            allocation,
            success: result.success,
            success_ci95: result.success_ci95,
            timeouts: result.timeouts,
            metrics: result.metrics.clone(),
            return_mean: result.return_mean,
            length_mean: result.length_mean,
            episodes: result.episodes,
            loss: window.agents.mean_loss(),
            gradient_norm: window.agents.mean_gradient_norm(),
            allocator_updates: updates.allocator + window.allocator.updates,
            allocator_loss: window.allocator.mean_loss(),
            epsilon: rates.epsilon,
            learning_rate: rates.learning_rate,
            training_success: episodes.solved as f64 / episodes.episodes.max(1) as f64,
        }
    }

    /// Closes the window: an evaluation was made.
    pub(crate) fn add_point(&mut self, point: CurvePoint) {
        let Window { agents, allocator, episodes } = std::mem::take(&mut self.window);
        self.updates.agents += agents.updates;
        self.updates.allocator += allocator.updates;
        self.decisions += episodes.decisions;
        self.curve.push(point);
    }
}

/// Wall time, and processor time of all threads of this process, since the last reading.
#[derive(Debug)]
pub(crate) struct Clock {
    wall: Instant,
    cpu_s: f64,
}

impl Clock {
    pub(crate) fn start() -> Self {
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        Self { wall: Instant::now(), cpu_s: cpu.tv_sec as f64 + cpu.tv_nsec as f64 * 1e-9 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_comes_to_as_many_steps_as_its_time_is_enough_for() {
        let mut counters = Counters::new(1);
        assert_eq!(counters.steps_in_all(1_000, 10.0), 1_000);
        (counters.env_steps, counters.cpu_s) = (100, 2.0);
        assert_eq!(counters.steps_in_all(1_000, 10.0), 500);
        assert_eq!(counters.steps_in_all(300, 10.0), 300);
        assert_eq!(counters.steps_in_all(1_000, 0.0), 1_000);
        // Its time is over.
        assert_eq!(counters.steps_in_all(1_000, 1.0), 100);
    }
}
