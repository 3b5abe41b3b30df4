//! The second program, `sortie-tools`: the verbs that compile, verify and measure, and the engines that run ONNX graphs.
//!
//! tract takes most of a first build, and a team whose bundle ships its plans needs none of it. So `sortie` does
//! without, and where an engine or one of those verbs is asked for becomes `sortie-tools`, which lies beside it and takes
//! the same words.

use std::env;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use clap::{Arg, ArgMatches};
use sortie_plans::{CompileError, Engines, check_version};

use crate::Program;
use crate::failure::{Failure, Outcome};

/// The file that the program is.
const FILE: &str = "sortie-tools";

/// The verbs that it has beside those of this crate, and what each is for.
pub const VERBS: [(&str, &str); 4] = [
    ("compile", "Compile an ONNX network to a plan for the runtime core"),
    ("verify", "Compare plans, tract, onnxruntime and recorded answers on inputs of all kinds"),
    ("bench", "Measure latency and throughput, ours and the peers' alternating in one run"),
    ("firmware", "Run a plan on an emulated microcontroller: bits, instructions, flash, RAM"),
];

/// What a program has that is `sortie-tools`.
pub trait Tools: Sync {
    /// What runs ONNX graphs.
    fn engines(&self) -> &'static dyn Engines;

    /// The grammar of one of [`VERBS`].
    fn grammar(&self, verb: &'static str) -> clap::Command;

    /// Does what one of [`VERBS`] is asked for.
    fn run(&self, verb: &str, matches: &ArgMatches) -> Outcome;
}

static RUNNING: OnceLock<&'static Program> = OnceLock::new();

/// Makes known which program runs, once.
pub(crate) fn start(program: &'static Program) {
    // A second call would come from a second `main`.
    let _ = RUNNING.set(program);
}

fn linked() -> Option<&'static dyn Tools> {
    RUNNING.get().and_then(|program| program.tools)
}

fn version() -> &'static str {
    RUNNING.get().map_or("", |program| program.version)
}

/// The engines of this program; where it has none, the program that has them goes on in its place.
pub fn engines() -> Result<&'static dyn Engines, Failure> {
    match linked() {
        Some(tools) => Ok(tools.engines()),
        None => Err(become_tools()),
    }
}

/// The program that links the engines: this one, or the one beside it.
pub(crate) fn program() -> PathBuf {
    if linked().is_some() {
        // Whatever becomes of the file: a build may replace it while this program runs.
        return PathBuf::from("/proc/self/exe");
    }
    env::current_exe().unwrap_or_default().with_file_name(FILE)
}

/// Fails early where that program is missing, or is of another version: before anything is computed for it.
pub fn check_program() -> Outcome {
    if linked().is_some() { Ok(()) } else { Ok(check_version(&program(), version())?) }
}

/// The version that `program` must be of; none where it is this program.
pub(crate) fn expected_version() -> Option<&'static str> {
    linked().is_none().then(version)
}

/// The grammar of one of [`VERBS`]: in full, or as much as is known without the program that has it.
pub(crate) fn grammar((verb, about): (&'static str, &str)) -> clap::Command {
    let about = format!("{about} [{FILE}]");
    match linked() {
        Some(tools) => {
            let grammar = tools.grammar(verb);
            let long =
                grammar.get_long_about().or(grammar.get_about()).cloned().unwrap_or_default();
            grammar.about(about).long_about(format!("{long}\n\nA verb of `{FILE}`."))
        }
        None => {
            let words = Arg::new("words").num_args(0..).hide(true);
            let words = words.trailing_var_arg(true).allow_hyphen_values(true);
            clap::Command::new(verb).about(about).disable_help_flag(true).arg(words)
        }
    }
}

/// Does what one of [`VERBS`] is asked for, here or in the program that has it.
pub(crate) fn run(verb: &str, matches: &ArgMatches) -> Outcome {
    match linked() {
        Some(tools) => tools.run(verb, matches),
        None => Err(become_tools()),
    }
}

/// Goes on as the program that has all verbs, if this one has not and the other lies beside it.
pub(crate) fn prefer_tools() -> Outcome {
    if linked().is_some() || !program().exists() { Ok(()) } else { Err(become_tools()) }
}

/// Goes on as the program with engines; returns only where that cannot be started.
fn become_tools() -> Failure {
    if let Err(failure) = check_program() {
        return failure;
    }
    let program = program();
    let error = Command::new(&program).args(env::args_os().skip(1)).exec();
    Failure::from(CompileError::not_started(program, &error))
}
