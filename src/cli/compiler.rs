//! The process that reads networks for this one, with limits, and the plans that come of it.
//!
//! A bundle's hashes say that its files belong together, not who made them: every network that a user names is
//! read there first.

use std::path::Path;

use clap::Args;
use sortie_bundle::Draft;
use sortie_plans::{BundlePlans, CompilerProcess, user_cache};

use crate::failure::{Exit, Failure, Outcome};
use crate::output::tell;
use crate::tools::{engines, expected_version, program};

/// Read one network for another process; started by all that compile
#[derive(Debug, Args)]
pub struct CompilerArguments {}

/// What reads networks.
pub fn compiler() -> CompilerProcess {
    let process = CompilerProcess::new(program(), ["compiler"]);
    match expected_version() {
        Some(version) => process.of_version(version),
        None => process,
    }
}

/// The plans of bundles.
pub fn plans() -> BundlePlans<CompilerProcess> {
    BundlePlans::new(compiler(), user_cache(), |note| tell!("note: {note}"))
}

/// The bundle with the plans of its networks, which are compiled anew.
pub fn with_plans(mut draft: Draft, folder: &Path) -> Result<Draft, Failure> {
    let bundle = draft.unwritten(folder)?;
    let compiled = plans().shipped(&bundle);
    let compiled = compiled.map_err(|error| Failure::from(error).within(folder.display()))?;
    for (name, plan) in compiled {
        draft.parts.insert(name, plan);
    }
    Ok(draft)
}

pub fn run(_: &CompilerArguments) -> Outcome {
    let answered = engines()?.answer_compiler();
    answered.map_err(|error| Failure::new(Exit::InputOutput, error.to_string()))
}
