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

fn main() -> ExitCode {
    failure::end_quietly_when_nobody_reads();
    let arguments = arguments::Arguments::parse();
    match arguments::dispatch(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if !failure.message.is_empty() {
                eprintln!("error: {}", failure.message);
            }
            ExitCode::from(failure.exit as u8)
        }
    }
}
