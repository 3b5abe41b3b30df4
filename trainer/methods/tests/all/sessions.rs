//! Runs of whatever method in whatever environment, found by their names.

use std::path::Path;

use sortie_envs::{Environment, Split};
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::evaluate;
use sortie_learn::run::{CurvePoint, RunDescription, read_curve, read_description};
use sortie_learn::session::{Opening, Parts, Session, Setup, load_weights};
use sortie_learn::{LearnError, Method};
use sortie_methods::alma::records::{Config, Records};
use sortie_methods::alma::windows::{self, WindowLearner};
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

/// A run, to use what it learned.
pub(crate) struct Opened<M> {
    pub(crate) description: RunDescription,
    pub(crate) curve: Vec<CurvePoint>,
    pub(crate) environment: Box<dyn Environment>,
    pub(crate) method: M,
}

impl<M: Method> Opened<M> {
    fn of(folder: &Path, method: impl FnOnce(&Setup, &dyn Environment) -> M) -> Self {
        let description = read_description(folder).unwrap();
        let environment = environment_of(&description.config).unwrap();
        let mut method = method(&description.config, &*environment);
        load_weights(folder, &mut method).unwrap();
        Self { description, curve: read_curve(folder).unwrap(), environment, method }
    }

    /// What its team achieves in so many episodes, as the run itself measures it.
    pub(crate) fn measured(&self, episodes: usize, seed: u64) -> Evaluation {
        evaluate(&*self.environment, &mut *self.method.team(), episodes, seed).unwrap()
    }

    /// Why its agents are not deployed.
    pub(crate) fn refused(&self) -> String {
        self.method.deployed().err().expect("agents that are evaluated only").to_string()
    }
}

/// A run that learned from records.
pub(crate) fn open_records(folder: &Path) -> Opened<Records> {
    Opened::of(folder, |setup, environment| {
        Records::new(&Config::of(setup).unwrap(), environment, 1, 1)
    })
}

/// A run that learned from windows.
pub(crate) fn open_windows(folder: &Path) -> Opened<WindowLearner> {
    Opened::of(folder, |setup, environment| {
        WindowLearner::new(&windows::Config::of(setup).unwrap(), environment.spec(), 1, 1)
    })
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
