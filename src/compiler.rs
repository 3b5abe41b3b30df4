//! The process that reads networks for this one: this program again, with limits.
//!
//! A bundle's hashes say that its files belong together, not who made them: every network that a user names is
//! read there first.

use clap::Args;
use sortie_compiler::{CompilerProcess, answer_compiler};

use crate::failure::{Exit, Failure, Outcome};

/// Read one network for another process; started by all that compile
#[derive(Debug, Args)]
pub(crate) struct CompilerArguments {}

/// What reads networks.
pub(crate) fn compiler() -> CompilerProcess {
    CompilerProcess::new("/proc/self/exe", ["compiler"])
}

pub(crate) fn run(_: &CompilerArguments) -> Outcome {
    answer_compiler().map_err(|error| Failure::new(Exit::InputOutput, error.to_string()))
}
