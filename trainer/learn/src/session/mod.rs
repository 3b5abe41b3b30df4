//! A run of any method in any environment, from its first step to its last, or from where it was stopped.
//!
//! What a method and an environment do not have to care for: the loop in which teams play, evaluations, curves,
//! checkpoints, an exact resume.
//!
//! The same [`Setup`] and seed give the same weights, whatever the number of threads.

mod entry;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_envs::Environment;

pub use entry::{Flag, MethodEntry, Opening, Preset};

pub use crate::run::{EnvironmentChoice, Setup};

use crate::error::LearnError;
use crate::evaluate::{Evaluation, Score};
use crate::method::{Method, Now};
use crate::play::{self, Play};
use crate::random::{Purpose, generator};
use crate::run::checkpoint::{OpenFor, Written};
use crate::run::{
    Counters, CurvePoint, Labels, Learning, Observer, Outcome, Progress, Rates, Reports, RunConfig,
    RunDescription, RunFolder, learn,
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
    ) -> Result<Self, LearnError> {
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
        open: impl FnOnce(&RunDescription) -> Result<Parts, LearnError>,
    ) -> Result<Self, LearnError> {
        let files = RunFolder::claim(folder)?;
        let mut description = files.read_description()?;
        description.config.run.settle_products()?;
        let (environment, method) = open(&description)?;
        let mut session = Self::start(description, environment, method, files);
        if !session.folder.checkpoints().exist()? {
            session.take_over()?;
            return Ok(session);
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
    fn take_over(&mut self) -> Result<(), LearnError> {
        let from = &self.description.config.run.from;
        if from.is_empty() { Ok(()) } else { self.method.take_over(Path::new(from)) }
    }

    /// Names everything that the run depends on.
    fn visit(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        state.value("counters", &mut self.counters)?;
        self.play.state(state)?;
        self.method.state(state)
    }

    /// Learns until all steps are taken or `stop` is set, and writes a checkpoint at the end.
    ///
    /// # Errors
    /// A file cannot be written, or learning has left the numbers.
    pub fn run(
        &mut self,
        observer: &mut dyn Observer,
        stop: &AtomicBool,
    ) -> Result<Outcome, LearnError> {
        learn(self, observer, stop)
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

    fn now(&self) -> Now {
        Now { env_steps: self.counters.env_steps, of: self.description.config.run.steps }
    }
}

/// Gives a method the newest weights of a run, to be used; why newer checkpoints were passed over.
///
/// # Errors
/// There is no sound checkpoint, or it is of another method.
pub fn load_weights(folder: &Path, method: &mut dyn Method) -> Result<Vec<String>, LearnError> {
    let found = RunFolder::new(folder).checkpoints().newest(OpenFor::Use)?;
    method.state(&mut State::weights(&found.checkpoint))?;
    Ok(found.refused)
}

impl Learning for Session {
    fn schedule(&self) -> RunConfig {
        self.description.config.run.clone()
    }

    fn labels(&self) -> Labels {
        let RunDescription { seed, config, .. } = &self.description;
        let (method, environment) = (&config.method, config.environment.to_string());
        Labels {
            title: format!("{method} on {environment}, seed {seed}"),
            environment,
            allocation: self.method.allocation().to_owned(),
            seed: *seed,
            score: self.score(),
        }
    }

    fn rates(&self) -> Rates {
        self.method.rates(self.now())
    }

    fn folder(&mut self) -> &mut RunFolder {
        &mut self.folder
    }

    fn counters(&mut self) -> &mut Counters {
        &mut self.counters
    }

    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let now = self.now();
        let window = &mut self.counters.window;
        let steps = self.play.round(&mut *self.method, now, &mut window.episodes)?;
        self.counters.env_steps += steps;
        let now = self.now();
        let mut reports = Reports::default();
        self.method.update(self.play.environment(), now, &mut reports)?;
        self.counters.window.add(reports, now.env_steps)?;
        observer.progress(&Progress { env_steps: now.env_steps, env_steps_total: now.of });
        Ok(())
    }

    fn recent(&self) -> BTreeMap<String, f64> {
        self.play.recent()
    }

    fn measure(&self, episodes: usize, seed: u64) -> Result<Evaluation, LearnError> {
        play::evaluate(&*self.environment, &mut *self.method.team(), episodes, seed)
    }

    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let mut written = Written::default();
        self.visit(&mut State::write(&mut written))?;
        let checkpoints = self.folder.checkpoints();
        observer.saved(&checkpoints.write(self.counters.env_steps, &written)?);
        Ok(())
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
