//! A run that learns, whatever the method.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_learn::LearnError;
use sortie_learn::run::{
    Configuration, CurvePoint, Observer, Outcome, RunDescription, read_description,
};
use sortie_learn::session::{Parts, Session};

use super::records::Records;
use super::settings::Settings;
use super::windows;

/// A run that learns from records or from windows.
#[derive(Debug)]
pub enum Trainer {
    /// The preset `fast`.
    Records(Box<Session<Settings>>),
    /// The preset `paper`.
    Windows(Box<windows::Trainer>),
    /// Any other method.
    Method(Box<Session>),
}

/// The world of a run, and what learns in it as it is before its first step.
fn parts(description: &RunDescription<Settings>, threads: usize) -> Result<Parts, LearnError> {
    let Settings::Records(config) = &description.config else {
        return Err(LearnError::Config("windows are learned from elsewhere".to_owned()));
    };
    let method = Records::new(config, description.seed, threads.max(1))?;
    Ok((Box::new(config.environment.open()?), Box::new(method)))
}

impl Trainer {
    /// Begins a run in a new folder.
    pub fn new(
        settings: Settings,
        seed: u64,
        threads: usize,
        folder: &Path,
    ) -> Result<Self, LearnError> {
        Ok(match settings {
            Settings::Records(_) => {
                settings.check()?;
                let description = RunDescription::new(settings, seed, threads.max(1));
                let (environment, method) = parts(&description, threads)?;
                Self::Records(Box::new(Session::begin(description, environment, method, folder)?))
            }
            Settings::Windows(config) => {
                Self::Windows(Box::new(windows::Trainer::new(config, seed, threads, folder)?))
            }
        })
    }

    /// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped.
    ///
    /// `threads` may differ from before; it changes no result. `None` takes as many as before.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, LearnError> {
        let RunDescription { config, .. } = read_description::<Settings>(folder)?;
        Ok(match config {
            Settings::Records(_) => {
                let session = Session::resume(folder, |description| {
                    parts(description, threads.unwrap_or(description.threads))
                })?;
                Self::Records(Box::new(session))
            }
            Settings::Windows(_) => {
                Self::Windows(Box::new(windows::Trainer::resume(folder, threads)?))
            }
        })
    }

    /// Learns until all steps are taken or `stop` is set, and writes a checkpoint at the end.
    pub fn run(
        &mut self,
        observer: &mut dyn Observer,
        stop: &AtomicBool,
    ) -> Result<Outcome, LearnError> {
        match self {
            Self::Records(session) => session.run(observer, stop),
            Self::Windows(trainer) => trainer.run(observer, stop),
            Self::Method(session) => session.run(observer, stop),
        }
    }

    /// Environment steps of the whole run.
    pub fn steps(&self) -> u64 {
        match self {
            Self::Records(session) => session.description().config.run().steps,
            Self::Windows(trainer) => trainer.description().config.run.steps,
            Self::Method(session) => session.description().config.run.steps,
        }
    }

    /// The steps from which a learned allocator of the preset `fast` learns, and from which it decides.
    pub fn allocator_steps(&self) -> Option<[u64; 2]> {
        let Self::Records(session) = self else { return None };
        let Settings::Records(config) = &session.description().config else { return None };
        let steps = [config.allocator.learns_from, config.allocator.decides_from];
        config.learns_allocator().then_some(steps)
    }

    /// Environment steps taken.
    pub fn env_steps(&self) -> u64 {
        match self {
            Self::Records(session) => session.env_steps(),
            Self::Windows(trainer) => trainer.env_steps(),
            Self::Method(session) => session.env_steps(),
        }
    }

    /// The evaluations up to now.
    pub fn curve(&self) -> &[CurvePoint] {
        match self {
            Self::Records(session) => session.curve(),
            Self::Windows(trainer) => trainer.curve(),
            Self::Method(session) => session.curve(),
        }
    }

    /// Why newer checkpoints were passed over when the run was resumed.
    pub fn refused(&self) -> &[String] {
        match self {
            Self::Records(session) => session.refused(),
            Self::Windows(trainer) => trainer.refused(),
            Self::Method(session) => session.refused(),
        }
    }
}
