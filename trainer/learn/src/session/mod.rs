//! A run of any method in any environment, from its first step to its last, or from where it was stopped.
//!
//! What a method and an environment do not have to care for: the loop in which teams play, evaluations, curves,
//! checkpoints, an exact resume.
//!
//! The same [`Setup`] and seed give the same weights, whatever the number of threads.

mod entry;
#[cfg(test)]
mod tests;

use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use sortie_envs::Environment;

pub use entry::{Flag, MethodEntry, Opening, Preset};

pub use crate::run::{EnvironmentChoice, Setup};

use crate::error::{LearnError, Result};
use crate::evaluate::{Evaluation, Score};
use crate::method::Method;
use crate::play::{self, Play};
use crate::random::{Purpose, generator};
use crate::run::checkpoint::{OpenFor, Written};
use crate::run::{
    Clock, Counters, CurvePoint, Meter, Now, Observer, Outcome, Rates, RunConfig, RunDescription,
    RunFolder, RunResult,
};
use crate::state::State;

/// An environment, and a method as it is before its first step.
pub type Parts = (Box<dyn Environment>, Box<dyn Method>);

/// A run of any method in any environment.
pub struct Session {
    description: RunDescription,
    folder: RunFolder,
    environment: Box<dyn Environment>,
    method: Box<dyn Method>,
    play: Play,
    counters: Counters,
    refused: Vec<String>,
}

impl Session {
    /// Begins a run in a new folder.
    ///
    /// # Errors
    /// The folder is not empty or cannot be written, or the setup cannot work.
    pub fn begin(
        mut description: RunDescription,
        environment: Box<dyn Environment>,
        method: Box<dyn Method>,
        folder: &Path,
    ) -> Result<Self> {
        description.config.run.settle_products()?;
        let folder = RunFolder::new(folder);
        let mut session = Self::start(description, environment, method, folder);
        session.take_over()?;
        session.folder.create(&session.description)?;
        Ok(session)
    }

    /// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped; begins it anew where
    /// none was written yet.
    ///
    /// `open` makes environment and method as the run is set up; the method as it was before its first step.
    ///
    /// # Errors
    /// Another process learns in the folder, or its files cannot be read.
    pub fn resume(
        folder: &Path,
        open: impl FnOnce(&RunDescription) -> Result<Parts>,
    ) -> Result<Self> {
        let files = RunFolder::claim(folder)?;
        let mut description = files.read_description()?;
        description.config.run.settle_products()?;
        let (environment, method) = open(&description)?;
        let mut session = Self::start(description, environment, method, files);
        if !session.folder.checkpoints().exist()? {
            session.take_over()?;
            return Ok(session);
        }
        if !session.description.config.run.checkpoint_replay {
            return Err(LearnError::Config(
                "a run with `run.checkpoint_replay=false` keeps too little to go on: it can be evaluated and exported, and \
                 another run can begin with what it learned (`run.from`)"
                    .to_owned(),
            ));
        }
        let found = session.folder.checkpoints().newest(OpenFor::Resume)?;
        let values = found.checkpoint.state()?;
        session.visit(&mut State::read(&found.checkpoint, &values))?;
        session.refused = found.refused;
        Ok(session)
    }

    fn start(
        description: RunDescription,
        environment: Box<dyn Environment>,
        mut method: Box<dyn Method>,
        folder: RunFolder,
    ) -> Self {
        let Setup { environment: choice, run, .. } = &description.config;
        let stream = |index| generator(description.seed, Purpose::Rollout, index as u64);
        let random = (0..choice.instances).map(stream).collect();
        Self {
            play: Play::new(&*environment, &mut *method, random),
            counters: Counters::new(run.evaluate_every),
            refused: Vec::new(),
            description,
            folder,
            environment,
            method,
        }
    }

    /// Begins with the weights of another run, where the setup says so.
    fn take_over(&mut self) -> Result<()> {
        let from = &self.description.config.run.from;
        if from.is_empty() { Ok(()) } else { self.method.take_over(Path::new(from)) }
    }

    /// Names everything that the run depends on.
    fn visit(&mut self, state: &mut State<'_>) -> Result<()> {
        state.value("counters", &mut self.counters)?;
        self.play.state(state)?;
        self.method.state(state)
    }

    /// How the run learns.
    pub fn description(&self) -> &RunDescription {
        &self.description
    }

    /// What has learned.
    pub fn method(&self) -> &dyn Method {
        &*self.method
    }

    /// What says how good it is.
    pub fn score(&self) -> Score {
        Score::of(self.environment.spec())
    }

    /// The evaluations up to now.
    pub fn curve(&self) -> &[CurvePoint] {
        &self.counters.curve
    }

    /// Environment steps taken.
    pub fn env_steps(&self) -> u64 {
        self.counters.env_steps
    }

    /// Why newer checkpoints were passed over when the run was resumed.
    pub fn refused(&self) -> &[String] {
        &self.refused
    }
}

/// Gives a method the newest weights of a run, to be used; why newer checkpoints were passed over.
///
/// # Errors
/// There is no sound checkpoint, or it is of another method.
pub fn load_weights(folder: &Path, method: &mut dyn Method) -> Result<Vec<String>> {
    let found = RunFolder::new(folder).checkpoints().newest(OpenFor::Use)?;
    method.state(&mut State::weights(&found.checkpoint))?;
    Ok(found.refused)
}

/// The episodes that every run reports on in the end: the same for all runs, seen by none.
const REPORT_SEED: u64 = 2_000_000;

impl Session {
    /// Learns until all steps are taken or `stop` is set, and writes a checkpoint at the end; besides one before the
    /// first step, at every evaluation, and every some minutes.
    ///
    /// # Errors
    /// A file cannot be written, or learning has left the numbers.
    pub fn run(&mut self, observer: &mut dyn Observer, stop: &AtomicBool) -> Result<Outcome> {
        let schedule = self.description.config.run.clone();
        schedule.settled_products()?.use_here();
        let mut saves = Saves::new(&schedule, self.counters.env_steps);
        let mut meter = Meter::new(schedule.evaluate_every, &self.counters);
        self.folder.events.goes_on_from(self.counters.env_steps);
        if self.counters.env_steps == 0 {
            self.save(&mut saves, observer)?;
        }
        while self.counters.env_steps < self.now().of {
            if stop.load(Ordering::Relaxed) {
                self.save(&mut saves, observer)?;
                return Ok(Outcome::Stopped);
            }
            self.step(observer)?;
            if schedule.cpu_seconds > 0.0 {
                self.counters.add_time(&mut saves.clock);
            }
            if let Some(point) = meter.measure(&self.counters, self.rates()) {
                observer.trained(&point);
                self.folder.events.add_training(&point)?;
            }
            if self.counters.env_steps >= self.counters.next_evaluation {
                self.counters.next_evaluation += schedule.evaluate_every;
                self.evaluate(&mut saves, observer)?;
                meter.restart(&self.counters);
            } else if saves.last.elapsed() >= saves.pause {
                self.save(&mut saves, observer)?;
            }
        }
        let env_steps = self.counters.env_steps;
        if self.counters.curve.last().is_none_or(|point| point.env_steps < env_steps) {
            self.evaluate(&mut saves, observer)?;
        }
        self.save(&mut saves, observer)?;
        self.report(observer)?;
        Ok(Outcome::Finished)
    }

    fn now(&self) -> Now {
        let RunConfig { steps, cpu_seconds, .. } = self.description.config.run;
        let of = self.counters.steps_in_all(steps, cpu_seconds);
        Now { env_steps: self.counters.env_steps, of }
    }

    fn rates(&self) -> Rates {
        self.method.rates(self.now())
    }

    /// Takes some environment steps and makes the updates that are due.
    fn step(&mut self, observer: &mut dyn Observer) -> Result<()> {
        let now = self.now();
        let window = &mut self.counters.window;
        let steps = self.play.round(&mut *self.method, now, &mut window.episodes)?;
        self.counters.env_steps += steps;
        let now = self.now();
        let reports = self.method.update(self.play.environment(), now)?;
        self.counters.window.add(reports, now.env_steps)?;
        observer.progress(now);
        Ok(())
    }

    /// Measures what has been learned on so many greedy episodes.
    fn measure(&self, episodes: usize, seed: u64) -> Result<Evaluation> {
        play::evaluate(&*self.environment, &mut *self.method.team(), episodes, seed)
    }

    /// Measures what has been learned, adds a point to the curve, and writes a checkpoint.
    fn evaluate(&mut self, saves: &mut Saves, observer: &mut dyn Observer) -> Result<()> {
        self.counters.add_time(&mut saves.clock);
        let RunDescription { seed, config, .. } = &self.description;
        let title = format!("{} on {}, seed {seed}", config.method, config.environment);
        // Counted from the top, so that ordinary seeds remain fresh for later evaluations.
        let result = self.measure(config.run.evaluate_episodes, u64::MAX - seed)?;
        let allocation = self.method.allocation().to_owned();
        let mut point = self.counters.point(&result, allocation, self.rates());
        // Means of the environment's metrics over the last episodes that it learned from.
        let recent = self.play.recent().into_iter();
        point.metrics.extend(recent.map(|(name, mean)| (format!("training_{name}"), mean)));
        observer.evaluated(&point);
        self.counters.add_point(point);
        let score = self.score();
        let told = self.folder.write_curve(&title, score, &self.counters.curve);
        // Where the disk takes no picture it may still take what was learned.
        self.save(saves, observer)?;
        told
    }

    /// Measures the finished run on episodes that no run uses before its end.
    fn report(&self, observer: &mut dyn Observer) -> Result<()> {
        let Setup { environment, run, .. } = &self.description.config;
        if run.final_episodes == 0 {
            return Ok(());
        }
        let result = RunResult {
            env: environment.to_string(),
            allocation: self.method.allocation().to_owned(),
            seed: REPORT_SEED,
            evaluation: self.measure(run.final_episodes, REPORT_SEED)?,
        };
        self.folder.write_result(&result)?;
        observer.finished(&result);
        Ok(())
    }

    /// Writes a checkpoint, unless the newest is of this very step.
    fn save(&mut self, saves: &mut Saves, observer: &mut dyn Observer) -> Result<()> {
        let env_steps = self.counters.env_steps;
        if saves.env_steps == Some(env_steps) {
            return Ok(());
        }
        self.counters.add_time(&mut saves.clock);
        let mut written = Written::default();
        let mut state = match self.description.config.run.checkpoint_replay {
            true => State::write(&mut written),
            false => State::write_kept(&mut written),
        };
        self.visit(&mut state)?;
        observer.saved(&self.folder.checkpoints().write(env_steps, &written)?);
        (saves.env_steps, saves.last) = (Some(env_steps), Instant::now());
        Ok(())
    }
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
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { description, counters, .. } = self;
        f.debug_struct("Session")
            .field("description", description)
            .field("counters", counters)
            .finish_non_exhaustive()
    }
}
