//! The command line of Sortie: teams of learned agents, from training to deployment.

mod allocator;
mod arguments;
mod bench;
mod compare;
mod compile;
mod compiler;
mod control;
mod deployment;
mod doctor;
mod environment;
mod episodes;
mod eval;
mod export;
mod failure;
mod inspect;
mod latency;
mod observations;
mod onnxruntime;
mod output;
mod policy;
mod proposals;
mod replay;
mod run;
mod signals;
mod subject;
mod subject_allocator;
mod terminal_curve;
mod train;
mod verify;
mod view;
mod worlds;

use std::process::ExitCode;

use clap::Parser;

use crate::failure::Outcome;
use crate::output::tell;

fn main() -> ExitCode {
    match work() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if !failure.message.is_empty() {
                tell!("error: {}", failure.message);
            }
            ExitCode::from(failure.exit as u8)
        }
    }
}

fn work() -> Outcome {
    match arguments::Arguments::try_parse() {
        Ok(arguments) => arguments::dispatch(arguments)?,
        Err(message) => output::explain(&message)?,
    }
    output::check()
}
