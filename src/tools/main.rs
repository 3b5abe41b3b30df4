//! The command line of Sortie with what reads and runs ONNX files inside (tract, the compiler, onnxruntime's binding) and
//! the verbs that compile, verify and measure.
//!
//! They take minutes to compile. `sortie` does without, and starts this program in its place where they are needed.

mod bench;
mod certify;
mod compile;
mod document;
mod firmware;
mod verify;

use std::process::ExitCode;

use clap::{ArgMatches, Args, Command, FromArgMatches};
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::tools::Tools;
use sortie_cli::{Program, run_program};
use sortie_compiler::LinkedEngines;
use sortie_plans::Engines;

use bench::BenchArguments;
use certify::CertifyArguments;
use compile::CompileArguments;
use firmware::FirmwareArguments;
use verify::VerifyArguments;

fn main() -> ExitCode {
    // A person is told what is wrong with the file, not where its reader gave up.
    sortie_compiler::silence_guarded_panics();
    run_program(&Program {
        version: sortie_version::SHORT,
        built: sortie_version::LONG,
        tools: Some(&Linked),
        zenoh: None,
    })
}

/// What this program has and `sortie` has not.
struct Linked;

impl Tools for Linked {
    fn engines(&self) -> &'static dyn Engines {
        &LinkedEngines
    }

    fn grammar(&self, verb: &'static str) -> Command {
        let command = Command::new(verb);
        match verb {
            "compile" => CompileArguments::augment_args(command),
            "verify" => VerifyArguments::augment_args(command),
            "bench" => BenchArguments::augment_args(command),
            "firmware" => FirmwareArguments::augment_args(command),
            "certify" => CertifyArguments::augment_args(command),
            _ => command,
        }
    }

    fn run(&self, verb: &str, matches: &ArgMatches) -> Outcome {
        match verb {
            "compile" => compile::run(&read(matches)?),
            "verify" => verify::run(&read(matches)?),
            "bench" => bench::run(&read(matches)?),
            "firmware" => firmware::run(&read(matches)?),
            "certify" => certify::run(&read(matches)?),
            _ => Err(Failure::new(Exit::Usage, format!("`{verb}` is no verb"))),
        }
    }
}

fn read<A: FromArgMatches>(matches: &ArgMatches) -> Result<A, Failure> {
    A::from_arg_matches(matches).map_err(Failure::bug)
}
