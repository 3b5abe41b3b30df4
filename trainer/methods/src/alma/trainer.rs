//! A run that learns, whatever the method.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_learn::run::{Configuration, CurvePoint, Observer, Outcome, RunDescription};
use sortie_learn::session::{Parts, Session};
use sortie_learn::{LearnError, Method};

use super::records::Records;
use super::settings::Settings;
use super::windows::WindowLearner;

/// A run that learns.
#[derive(Debug)]
pub enum Trainer {
    /// ALMA, flat agents and COPA.
    Alma(Box<Session<Settings>>),
    /// Any other method.
    Method(Box<Session>),
}

/// The world of a run, and what learns in it as it is before its first step.
fn parts(description: &RunDescription<Settings>, threads: usize) -> Result<Parts, LearnError> {
    let (seed, threads) = (description.seed, threads.max(1));
    let environment = Settings::environment(&description.config).open()?;
    let method: Box<dyn Method> = match &description.config {
        Settings::Records(config) => Box::new(Records::new(config, seed, threads)?),
        Settings::Windows(config) => Box::new(WindowLearner::new(config, seed, threads)?),
    };
    Ok((Box::new(environment), method))
}

impl Trainer {
    /// Begins a run in a new folder.
    pub fn new(
        settings: Settings,
        seed: u64,
        threads: usize,
        folder: &Path,
    ) -> Result<Self, LearnError> {
        settings.check()?;
        let description = RunDescription::new(settings, seed, threads.max(1));
        let (environment, method) = parts(&description, threads)?;
        let session = Session::begin(description, environment, method, folder)?;
        Ok(Self::Alma(Box::new(session)))
    }

    /// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped.
    ///
    /// `threads` may differ from before; it changes no result. `None` takes as many as before.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, LearnError> {
        let session = Session::resume(folder, |description| {
            parts(description, threads.unwrap_or(description.threads))
        })?;
        Ok(Self::Alma(Box::new(session)))
    }

    /// Learns until all steps are taken or `stop` is set, and writes a checkpoint at the end.
    pub fn run(
        &mut self,
        observer: &mut dyn Observer,
        stop: &AtomicBool,
    ) -> Result<Outcome, LearnError> {
        match self {
            Self::Alma(session) => session.run(observer, stop),
            Self::Method(session) => session.run(observer, stop),
        }
    }

    /// Environment steps of the whole run.
    pub fn steps(&self) -> u64 {
        match self {
            Self::Alma(session) => session.description().config.run().steps,
            Self::Method(session) => session.description().config.run.steps,
        }
    }

    /// The steps from which a learned allocator of the preset `fast` learns, and from which it decides.
    pub fn allocator_steps(&self) -> Option<[u64; 2]> {
        let Self::Alma(session) = self else { return None };
        let Settings::Records(config) = &session.description().config else { return None };
        let steps = [config.allocator.learns_from, config.allocator.decides_from];
        config.learns_allocator().then_some(steps)
    }

    /// Environment steps taken.
    pub fn env_steps(&self) -> u64 {
        match self {
            Self::Alma(session) => session.env_steps(),
            Self::Method(session) => session.env_steps(),
        }
    }

    /// The evaluations up to now.
    pub fn curve(&self) -> &[CurvePoint] {
        match self {
            Self::Alma(session) => session.curve(),
            Self::Method(session) => session.curve(),
        }
    }

    /// Why newer checkpoints were passed over when the run was resumed.
    pub fn refused(&self) -> &[String] {
        match self {
            Self::Alma(session) => session.refused(),
            Self::Method(session) => session.refused(),
        }
    }
}
