//! The command line of Sortie: teams of learned agents, from training to deployment.
//!
//! All programs are this library: `sortie` as it is, `sortie-tools` with engines for ONNX graphs and the verbs that need or
//! measure them, `sortie-zenoh` with zenoh for lines between hosts and for ROS 2. What is public here is what those verbs share with
//! the others, and no interface for anybody else.
#![expect(
    missing_docs,
    reason = "public for the program beside, where names say it; no interface for anybody else"
)]

mod ahead;
pub mod allocation;
pub mod allocator;
mod arguments;
mod bridge;
mod compare;
mod control;
pub mod deployment;
mod doctor;
pub mod environment;
mod eval;
mod export;
pub mod failure;
pub mod files;
pub mod foreign;
pub mod guards;
mod inspect;
mod join;
pub mod latency;
pub mod line;
mod listener;
pub mod methods;
pub mod npz;
pub mod output;
pub mod policy;
mod quantities;
mod record;
pub mod remake;
mod replay;
mod reproduce;
pub mod run;
mod screen;
mod seeds;
mod serve;
mod sign;
pub mod subject;
mod swap;
pub mod terminal;
pub mod tools;
mod top;
mod train;
pub mod trust;
mod view;
mod views;
pub mod worlds;
pub mod zenoh;

pub use views::{PAGE_PROGRAM, cast};

use std::process::ExitCode;

use crate::failure::Outcome;
use crate::tools::Tools;
use crate::zenoh::Zenoh;

/// What differs between the programs.
pub struct Program {
    /// `0.1.0 (077de5c 2026-11-22)`.
    pub version: &'static str,
    /// The same, and how it was built.
    pub built: &'static str,
    /// What `sortie-tools` has and `sortie` has not.
    pub tools: Option<&'static dyn Tools>,
    /// What `sortie-zenoh` has and `sortie` has not.
    pub zenoh: Option<&'static dyn Zenoh>,
}

/// Does what the command line says.
pub fn run_program(program: &'static Program) -> ExitCode {
    tools::start(program);
    // Where it cannot be had the signal ends the process, as it would any other.
    let _ = sortie_ipc::outlive_file_limits();
    match work(program) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if !failure.message.is_empty() {
                tell!("error: {}", failure.message);
            }
            ExitCode::from(failure.exit as u8)
        }
    }
}

fn work(program: &Program) -> Outcome {
    let words: Vec<_> = std::env::args_os().collect();
    match arguments::read(program, &words) {
        Ok(asked) => arguments::dispatch(program, asked)?,
        Err(message) => output::explain(&message)?,
    }
    output::check()
}
