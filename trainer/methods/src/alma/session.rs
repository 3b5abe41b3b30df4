//! Runs of ALMA that learn.

use std::path::Path;

use sortie_envs::Environment;
use sortie_learn::run::{Configuration, RunDescription};
use sortie_learn::session::{Parts, Session};
use sortie_learn::{LearnError, Method};

use super::records::Records;
use super::settings::Settings;
use super::windows::WindowLearner;

/// Begins a run in a new folder.
///
/// # Errors
/// The folder is not empty or cannot be written, or the settings cannot work.
pub fn begin(
    settings: Settings,
    seed: u64,
    threads: usize,
    folder: &Path,
) -> Result<Session<Settings>, LearnError> {
    settings.check()?;
    let description = RunDescription::new(settings, seed, threads.max(1));
    let (environment, method) = parts(&description, threads)?;
    Session::begin(description, environment, method, folder)
}

/// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped.
///
/// `threads` may differ from before; it changes no result. `None` takes as many as before.
///
/// # Errors
/// Another process learns in the folder, or its files cannot be read.
pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Session<Settings>, LearnError> {
    let open = |description: &RunDescription<Settings>| {
        parts(description, threads.unwrap_or(description.threads))
    };
    Session::resume(folder, open)
}

/// The world of a run, and what learns in it as it is before its first step.
fn parts(description: &RunDescription<Settings>, threads: usize) -> Result<Parts, LearnError> {
    let (seed, threads) = (description.seed, threads.max(1));
    let environment = Settings::environment(&description.config).open()?;
    let method: Box<dyn Method> = match &description.config {
        Settings::Records(config) => Box::new(Records::new(config, &environment, seed, threads)),
        Settings::Windows(config) => {
            let shape = environment.spec().shape;
            Box::new(WindowLearner::new(config, shape, seed, threads))
        }
    };
    Ok((Box::new(environment), method))
}
