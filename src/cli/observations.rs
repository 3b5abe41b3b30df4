//! Recorded observations: a policy that keeps what it decides on, and the files of it.

use std::fs;
use std::path::Path;

use sortie_bundle::{Bundle, Recording};
use sortie_core::{DecideError, Decision, Observation, Policy};

use crate::failure::{Exit, Failure, Outcome};
use crate::files::write_output;

/// A policy that records every observation that it decides on.
pub struct RecordingPolicy<'a> {
    policy: &'a mut dyn Policy,
    recording: Recording,
}

impl<'a> RecordingPolicy<'a> {
    pub fn new(policy: &'a mut dyn Policy, bundle: &Bundle) -> Self {
        let contract = bundle.contract();
        let (features, actions) = (contract.features.into(), contract.actions.into());
        Self { policy, recording: Recording::new(contract.hash(), features, actions) }
    }

    /// All that was recorded.
    pub fn into_recording(self) -> Recording {
        self.recording
    }

    /// Writes all that was recorded.
    pub fn write(&self, path: &Path) -> Outcome {
        write_output(path, &self.recording.to_bytes())
    }
}

impl Policy for RecordingPolicy<'_> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.policy.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.recording.add(observation);
        self.policy.decide(observation)
    }
}

/// Reads a file of observations, whatever they are of.
pub fn read_any_recording(path: &Path) -> Result<Recording, Failure> {
    let bytes = fs::read(path).map_err(|error| Failure::file(path, &error))?;
    Recording::from_bytes(&bytes)
        .map_err(|error| Failure::new(Exit::BadData, error.to_string()).within(path.display()))
}

/// Reads a file of observations that fit a bundle.
pub fn read_recording(path: &Path, bundle: &Bundle) -> Result<Recording, Failure> {
    let recording = read_any_recording(path)?;
    let (want, got) = (bundle.contract().hash(), recording.contract);
    if want != got {
        let message = format!(
            "{}: recorded under contract {got:016x}, {} has {want:016x}: record with `sortie eval {} --dump FILE`",
            path.display(),
            bundle.folder().display(),
            bundle.folder().display()
        );
        return Err(Failure::new(Exit::Mismatch, message));
    }
    Ok(recording)
}
