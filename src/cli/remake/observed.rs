//! What agents saw, out of a record of their team.

use std::cell::RefCell;
use std::fs::File;
use std::path::Path;

use sortie_bundle::{Bundle, Recording};
use sortie_core::Policy;
use sortie_learn::draft::DecoratedPolicy;
use sortie_record::{Reader, RecordError};

use super::Deployed;
use super::comparison::Comparison;
use super::contents::Contents;
use super::roles::Roles;
use crate::failure::Failure;
use crate::files::{read_recording, recording_of};

/// Observations that fit a bundle: of a file of them, or of a record of a team that ran the bundle.
///
/// # Errors
/// The file is neither, or of another contract; of a record: its bundle is another one.
pub fn read_observations(path: &Path, bundle: &Bundle) -> Result<Recording, Failure> {
    if is_record(path)? { of_record(path, bundle) } else { read_recording(path, bundle) }
}

/// Whether it is a record of a team. What can be read once only, as a pipe, is none: records are read twice.
fn is_record(path: &Path) -> Result<bool, Failure> {
    let failed = |error| Failure::file(path, &error);
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Ok(false);
    }
    match Reader::new(File::open(path).map_err(failed)?) {
        Ok(_) => Ok(true),
        Err(RecordError::Io(error)) => Err(failed(error)),
        Err(_) => Ok(false),
    }
}

fn of_record(path: &Path, bundle: &Bundle) -> Result<Recording, Failure> {
    let contents = Contents::read(path)?;
    let recording = RefCell::new(recording_of(bundle));
    let mut deployed = Deployed::open_agents(&contents, bundle)?;
    let mut team = deployed.team()?;
    team.policies = team.policies.into_iter().map(|policy| noting(policy, &recording)).collect();
    let mut comparison = Comparison::default();
    let mut roles = Roles::new(&contents, bundle, vec![team], &mut comparison)?;
    contents.replay(&mut |message| roles.hear(message))?;
    roles.end();
    drop(deployed);
    Ok(recording.into_inner())
}

fn noting<'a>(
    policy: Box<dyn Policy + 'a>,
    recording: &'a RefCell<Recording>,
) -> Box<dyn Policy + 'a> {
    Box::new(DecoratedPolicy::new(policy, |policy, observation, _| {
        recording.borrow_mut().add(observation);
        policy.decide(observation)
    }))
}
