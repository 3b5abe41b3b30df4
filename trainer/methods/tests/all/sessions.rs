//! Runs of whatever method in whatever environment, found by their names.

use std::path::Path;

use sortie_envs::{Environment, Split};
use sortie_learn::run::{RunDescription, read_description};
use sortie_learn::session::{Opening, Parts, Session, Setup};
use sortie_learn::{LearnError, Method};
use sortie_methods::alma::run::Run;
use sortie_methods::find;

/// The setup with some values replaced.
pub(crate) fn with(setup: &Setup, assignments: &[&str]) -> Setup {
    let entry = find(&setup.method).unwrap();
    let set = |setup: Setup, assignment: &&str| entry.set(&setup, assignment);
    assignments.iter().try_fold(setup.clone(), set).unwrap_or_else(|error| panic!("{error}"))
}

/// The environment that a setup names.
pub(crate) fn environment_of(setup: &Setup) -> Result<Box<dyn Environment>, LearnError> {
    let choice = &setup.environment;
    Ok(sortie_envs::open(&choice.to_string(), Split::Train, 1, &choice.settings)?)
}

/// A run of ALMA, to use what it learned.
pub(crate) fn open_run(folder: &Path) -> Result<Run, LearnError> {
    let environment = environment_of(&read_description(folder)?.config)?;
    Run::open(folder, environment.spec())
}

/// Its environment and its method before the first step.
fn open(description: &RunDescription, threads: usize) -> Result<Parts, LearnError> {
    let RunDescription { config: setup, seed, .. } = description;
    let environment = environment_of(setup)?;
    let opening = Opening { setup, environment: &*environment, seed: *seed, threads };
    let method: Box<dyn Method> = find(&setup.method).unwrap().method(&opening)?;
    Ok((environment, method))
}

/// A run in a new folder.
pub(crate) fn begin(
    setup: Setup,
    seed: u64,
    threads: usize,
    folder: &Path,
) -> Result<Session, LearnError> {
    let description = RunDescription::new(setup, seed, threads);
    let (environment, method) = open(&description, threads)?;
    Session::begin(description, environment, method, folder)
}

/// The run in a folder, with other threads than before or as many.
pub(crate) fn resume(folder: &Path, threads: Option<usize>) -> Result<Session, LearnError> {
    Session::resume(folder, |description| open(description, threads.unwrap_or(description.threads)))
}
