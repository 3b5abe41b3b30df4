//! A run that learns, whatever the method.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::{records, windows};
use crate::alma::settings::Settings;
use sortie_learn::LearnError;
use sortie_learn::run::{CurvePoint, Observer, Outcome, RunDescription, read_description};
use sortie_learn::session::Session;

/// A run that learns from records or from windows.
#[derive(Debug)]
pub enum Trainer {
    /// The preset `fast`.
    Records(Box<records::Trainer>),
    /// The preset `paper`.
    Windows(Box<windows::Trainer>),
    /// Any other method.
    Method(Box<Session>),
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
            Settings::Records(config) => {
                Self::Records(Box::new(records::Trainer::new(config, seed, threads, folder)?))
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
                Self::Records(Box::new(records::Trainer::resume(folder, threads)?))
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
            Self::Records(trainer) => trainer.run(observer, stop),
            Self::Windows(trainer) => trainer.run(observer, stop),
            Self::Method(session) => session.run(observer, stop),
        }
    }

    /// Environment steps of the whole run.
    pub fn steps(&self) -> u64 {
        match self {
            Self::Records(trainer) => trainer.description().config.run.steps,
            Self::Windows(trainer) => trainer.description().config.run.steps,
            Self::Method(session) => session.description().config.run.steps,
        }
    }

    /// The steps from which a learned allocator of the preset `fast` learns, and from which it decides.
    pub fn allocator_steps(&self) -> Option<[u64; 2]> {
        let Self::Records(trainer) = self else { return None };
        let config = &trainer.description().config;
        let steps = [config.allocator.learns_from, config.allocator.decides_from];
        config.learns_allocator().then_some(steps)
    }

    /// Environment steps taken.
    pub fn env_steps(&self) -> u64 {
        match self {
            Self::Records(trainer) => trainer.env_steps(),
            Self::Windows(trainer) => trainer.env_steps(),
            Self::Method(session) => session.env_steps(),
        }
    }

    /// The evaluations up to now.
    pub fn curve(&self) -> &[CurvePoint] {
        match self {
            Self::Records(trainer) => trainer.curve(),
            Self::Windows(trainer) => trainer.curve(),
            Self::Method(session) => session.curve(),
        }
    }

    /// Why newer checkpoints were passed over when the run was resumed.
    pub fn refused(&self) -> &[String] {
        match self {
            Self::Records(trainer) => trainer.refused(),
            Self::Windows(trainer) => trainer.refused(),
            Self::Method(session) => session.refused(),
        }
    }
}
