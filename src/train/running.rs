//! A run that learns, by whatever method.

use std::sync::atomic::AtomicBool;

use sortie_learn::LearnError;
use sortie_learn::run::{Configuration, CurvePoint, Observer, Outcome};
use sortie_learn::session::Session;
use sortie_methods::alma::Settings;

/// A run that learns.
pub(super) enum Running {
    /// ALMA, flat agents and COPA.
    Alma(Box<Session<Settings>>),
    /// Any other method.
    Method(Box<Session>),
}

impl Running {
    /// Learns until all steps are taken or `stop` is set.
    pub(super) fn run(
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
    pub(super) fn steps(&self) -> u64 {
        match self {
            Self::Alma(session) => session.description().config.run().steps,
            Self::Method(session) => session.description().config.run.steps,
        }
    }

    /// The steps from which a learned allocator of the preset `fast` learns, and from which it decides.
    pub(super) fn allocator_steps(&self) -> Option<[u64; 2]> {
        let Self::Alma(session) = self else { return None };
        let Settings::Records(config) = &session.description().config else { return None };
        let steps = [config.allocator.learns_from, config.allocator.decides_from];
        config.learns_allocator().then_some(steps)
    }

    /// Environment steps taken.
    pub(super) fn env_steps(&self) -> u64 {
        match self {
            Self::Alma(session) => session.env_steps(),
            Self::Method(session) => session.env_steps(),
        }
    }

    /// The evaluations up to now.
    pub(super) fn curve(&self) -> &[CurvePoint] {
        match self {
            Self::Alma(session) => session.curve(),
            Self::Method(session) => session.curve(),
        }
    }

    /// Why newer checkpoints were passed over when the run was resumed.
    pub(super) fn refused(&self) -> &[String] {
        match self {
            Self::Alma(session) => session.refused(),
            Self::Method(session) => session.refused(),
        }
    }
}
