//! The course of a run: steps, evaluations and checkpoints in turn, whatever the method.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::{Clock, Counters, Observer, Outcome};
use crate::error::LearnError;
use crate::methods::alma::config::RunConfig;

/// A run that learns.
pub(crate) trait Learning {
    /// How long it learns, and when it measures and saves.
    fn schedule(&self) -> RunConfig;
    /// Where it is.
    fn counters(&mut self) -> &mut Counters;
    /// Takes some environment steps and makes the updates that are due.
    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError>;
    /// Measures what it has learned and adds a point to the curve.
    fn evaluate(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError>;
    /// Writes a checkpoint.
    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError>;
    /// Measures the finished run on episodes that no run uses before its end.
    fn report(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError>;
}

/// Learns until all steps are taken or `stop` is set, and writes a checkpoint at the end.
pub(crate) fn learn(
    run: &mut impl Learning,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, LearnError> {
    let schedule = run.schedule();
    let mut clock = Clock::start();
    let minutes = schedule.checkpoint_minutes.max(0.0);
    let pause = Duration::try_from_secs_f64(60.0 * minutes).unwrap_or(Duration::MAX);
    let mut saved = Instant::now();
    while run.counters().env_steps < schedule.steps {
        if stop.load(Ordering::Relaxed) {
            run.counters().add_time(&mut clock);
            run.save(observer)?;
            return Ok(Outcome::Stopped);
        }
        run.step(observer)?;
        if run.counters().env_steps >= run.counters().next_evaluation {
            run.counters().add_time(&mut clock);
            run.counters().next_evaluation += schedule.evaluate_every;
            run.evaluate(observer)?;
        }
        if saved.elapsed() >= pause {
            run.counters().add_time(&mut clock);
            run.save(observer)?;
            saved = Instant::now();
        }
    }
    run.counters().add_time(&mut clock);
    let env_steps = run.counters().env_steps;
    if run.counters().curve.last().is_none_or(|point| point.env_steps < env_steps) {
        run.evaluate(observer)?;
    }
    run.save(observer)?;
    run.report(observer)?;
    Ok(Outcome::Finished)
}
