//! The command line of Sortie: teams of learned agents, from training to deployment.

mod allocation;
mod allocator;
mod arguments;
mod bench;
mod compare;
mod compile;
mod compiler;
mod control;
mod deployment;
mod doctor;
mod engines;
mod environment;
mod episodes;
mod eval;
mod export;
mod failure;
mod files;
mod firmware;
mod foreign;
mod inspect;
mod latency;
mod manual;
mod methods;
mod npz;
mod observations;
mod onnxruntime;
mod options;
mod output;
mod policy;
mod progress;
mod proposals;
mod recorded_inputs;
mod replay;
mod reproduce;
mod run;
mod scripted;
mod seeds;
mod serve;
mod signals;
mod subject;
mod subject_allocator;
mod terminal;
mod terminal_curve;
mod train;
mod verify;
mod version;
mod view;
mod views;
mod worlds;

use std::process::ExitCode;

use sortie_plans::Engines;

use crate::failure::Outcome;
use crate::output::tell;

/// Does what the command line says, with the engines that the program links: none in `sortie`, which starts
/// `sortie-tract` in its place where they are needed.
pub fn main(engines: Option<&'static dyn Engines>) -> ExitCode {
    if let Some(engines) = engines {
        engines::link(engines);
    }
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
    let words: Vec<_> = std::env::args_os().collect();
    match arguments::Arguments::read(&words) {
        Ok(arguments) => arguments::dispatch(arguments)?,
        Err(message) => output::explain(&message)?,
    }
    output::check()
}
