//! The course of a run: steps, evaluations and checkpoints in turn, whatever the method.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::meter::Meter;
use super::{Clock, Counters, Observer, Outcome, Rates, RunConfig, RunFolder, RunResult};
use crate::error::LearnError;
use crate::evaluate::{Evaluation, Score};

/// A run that learns.
pub(crate) trait Learning {
    /// How long it learns, and when it measures and saves.
    fn schedule(&self) -> RunConfig;
    /// What it is to be called, and by what it is measured.
    fn labels(&self) -> Labels;
    /// Exploration and learning rate of the agents now.
    fn rates(&self) -> Rates;
    /// Its folder.
    fn folder(&mut self) -> &mut RunFolder;
    /// Where it is.
    fn counters(&mut self) -> &mut Counters;
    /// Takes some environment steps and makes the updates that are due.
    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError>;
    /// Means of the environment's metrics over the last episodes that it learned from, by their names.
    fn recent(&self) -> BTreeMap<String, f64>;
    /// Measures what it has learned on so many greedy episodes.
    fn measure(&self, episodes: usize, seed: u64) -> Result<Evaluation, LearnError>;
    /// Writes a checkpoint.
    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError>;
}

/// What a run is called and measured by.
#[derive(Clone, Debug)]
pub(crate) struct Labels {
    /// Heading of its curve.
    pub(crate) title: String,
    /// Environment and scenario set.
    pub(crate) environment: String,
    /// Who allocates.
    pub(crate) allocation: String,
    /// Its seed.
    pub(crate) seed: u64,
    /// What says how good it is.
    pub(crate) score: Score,
}

/// The episodes that every run reports on in the end: the same for all runs, seen by none.
const REPORT_SEED: u64 = 2_000_000;

/// Learns until all steps are taken or `stop` is set.
///
/// A checkpoint is written before the first step, at every evaluation, every some minutes, and at the end.
pub(crate) fn learn(
    run: &mut impl Learning,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, LearnError> {
    let schedule = run.schedule();
    schedule.settled_products()?.use_here();
    let mut saves = Saves::new(&schedule, run.counters().env_steps);
    let mut meter = Meter::new(schedule.evaluate_every, run.counters());
    let env_steps = run.counters().env_steps;
    run.folder().goes_on_from(env_steps);
    if env_steps == 0 {
        saves.save(run, observer)?;
    }
    while run.counters().env_steps < schedule.steps {
        if stop.load(Ordering::Relaxed) {
            saves.save(run, observer)?;
            return Ok(Outcome::Stopped);
        }
        run.step(observer)?;
        let rates = run.rates();
        if let Some(point) = meter.measure(run.counters(), rates) {
            observer.trained(&point);
            run.folder().write_training(&point)?;
        }
        if run.counters().env_steps >= run.counters().next_evaluation {
            run.counters().next_evaluation += schedule.evaluate_every;
            evaluate(run, observer, &mut saves)?;
            meter.restart(run.counters());
        } else if saves.are_due() {
            saves.save(run, observer)?;
        }
    }
    let env_steps = run.counters().env_steps;
    if run.counters().curve.last().is_none_or(|point| point.env_steps < env_steps) {
        evaluate(run, observer, &mut saves)?;
    }
    saves.save(run, observer)?;
    report(run, observer)?;
    Ok(Outcome::Finished)
}

/// When checkpoints are written.
struct Saves {
    pause: Duration,
    last: Instant,
    /// Environment steps of the newest checkpoint.
    env_steps: Option<u64>,
    clock: Clock,
}

impl Saves {
    /// A run that has taken steps has them from its checkpoint.
    fn new(schedule: &RunConfig, env_steps: u64) -> Self {
        let minutes = schedule.checkpoint_minutes.max(0.0);
        Self {
            pause: Duration::try_from_secs_f64(60.0 * minutes).unwrap_or(Duration::MAX),
            last: Instant::now(),
            env_steps: (env_steps > 0).then_some(env_steps),
            clock: Clock::start(),
        }
    }

    fn are_due(&self) -> bool {
        self.last.elapsed() >= self.pause
    }

    /// Writes a checkpoint, unless the newest is of this very step.
    fn save(
        &mut self,
        run: &mut impl Learning,
        observer: &mut dyn Observer,
    ) -> Result<(), LearnError> {
        let now = Some(run.counters().env_steps);
        if self.env_steps == now {
            return Ok(());
        }
        run.counters().add_time(&mut self.clock);
        run.save(observer)?;
        (self.env_steps, self.last) = (now, Instant::now());
        Ok(())
    }
}

/// Measures what has been learned, adds a point to the curve, and writes a checkpoint.
fn evaluate(
    run: &mut impl Learning,
    observer: &mut dyn Observer,
    saves: &mut Saves,
) -> Result<(), LearnError> {
    run.counters().add_time(&mut saves.clock);
    let Labels { title, allocation, seed, score, .. } = run.labels();
    // Counted from the top, so that ordinary seeds remain fresh for later evaluations.
    let result = run.measure(run.schedule().evaluate_episodes, u64::MAX - seed)?;
    let rates = run.rates();
    let recent = run.recent().into_iter().map(|(name, mean)| (format!("training_{name}"), mean));
    let mut point = run.counters().point(&result, allocation, rates);
    point.metrics.extend(recent);
    observer.evaluated(&point);
    run.counters().add_point(point);
    let curve = run.counters().curve.clone();
    let told = run.folder().write_curve(&title, score, &curve);
    // Where the disk takes no picture it may still take what was learned.
    saves.save(run, observer)?;
    told
}

/// Measures the finished run on episodes that no run uses before its end.
fn report(run: &mut impl Learning, observer: &mut dyn Observer) -> Result<(), LearnError> {
    let episodes = run.schedule().final_episodes;
    if episodes == 0 {
        return Ok(());
    }
    let Labels { environment, allocation, .. } = run.labels();
    let result = RunResult {
        env: environment,
        allocation,
        seed: REPORT_SEED,
        evaluation: run.measure(episodes, REPORT_SEED)?,
    };
    run.folder().write_result(&result)?;
    observer.finished(&result);
    Ok(())
}
