//! The second program, `sortie-tools`: the verbs that compile, verify and measure, and the engines that run ONNX graphs.
//!
//! tract takes most of a first build, and a team whose bundle ships its plans needs none of it. So `sortie` does
//! without, and where an engine or one of those verbs is asked for becomes `sortie-tools`, which lies beside it and takes
//! the same words.

use std::env;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use clap::{Arg, ArgMatches, Args};
use sortie_bundle::Draft;
use sortie_plans::{
    BundlePlans, CompileError, CompilerProcess, Engines, OnnxRuntimeEngine, OnnxRuntimeError,
    user_cache,
};

use crate::Program;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::tell;

/// The file that the program is.
const FILE: &str = "sortie-tools";

/// The verbs that it has beside those of this crate, and what each is for.
pub const VERBS: [(&str, &str); 5] = [
    ("compile", "Compile an ONNX network to a plan for the runtime core"),
    ("verify", "Compare plans, tract, onnxruntime and recorded answers on inputs of all kinds"),
    ("bench", "Measure latency and throughput, ours and the peers' alternating in one run"),
    ("firmware", "Run a plan on an emulated microcontroller: bits, instructions, flash, RAM"),
    ("certify", "Hold all decisions to one hash, on this machine and on emulated microcontrollers"),
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

/// The program that runs, once it is known.
pub(crate) fn running() -> Option<&'static Program> {
    RUNNING.get().copied()
}

fn linked() -> Option<&'static dyn Tools> {
    running().and_then(|program| program.tools)
}

fn version() -> &'static str {
    running().map_or("", |program| program.version)
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
    Ok(compiler().check_version()?)
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
    // That one would go on as this one, where it comes to the line.
    if running().is_some_and(|program| program.zenoh.is_some()) {
        let message = "zenoh and what runs ONNX graphs are in different programs: leave out `--backend tract`, or go without zenoh";
        return Failure::new(Exit::Usage, message);
    }
    if let Err(failure) = check_program() {
        return failure;
    }
    let program = program();
    let error = Command::new(&program).args(env::args_os().skip(1)).exec();
    Failure::from(CompileError::not_started(program, &error))
}

// The process that reads networks for this one, with limits, and the plans that come of it.
//
// A bundle's hashes say that its files belong together, not who made them: every network that a user names is
// read there first.

/// Read one network for another process; started by all that compile
#[derive(Debug, Args)]
pub struct CompilerArguments {}

/// What reads networks. All that this process asks of it finds the same program, whose version is looked at once.
pub fn compiler() -> CompilerProcess {
    static COMPILER: OnceLock<CompilerProcess> = OnceLock::new();
    let new = || {
        let process = CompilerProcess::new(program(), ["compiler"]);
        if linked().is_some() { process } else { process.of_version(version()) }
    };
    COMPILER.get_or_init(new).clone()
}

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

pub fn answer_compiler(_: &CompilerArguments) -> Outcome {
    let answered = engines()?.answer_compiler();
    answered.map_err(|error| Failure::new(Exit::InputOutput, error.to_string()))
}

/// Where onnxruntime is looked for.
#[derive(Clone, Debug, Args)]
pub struct OnnxRuntimeArguments {
    /// Interpreter that has the package `onnxruntime` [default: ORT_DYLIB_PATH, VIRTUAL_ENV, python3]
    #[arg(long, value_name = "PYTHON")]
    python: Option<PathBuf>,
}

impl OnnxRuntimeArguments {
    pub fn open(&self) -> Result<&'static dyn OnnxRuntimeEngine, Failure> {
        Ok(engines()?.onnxruntime(self.python.as_deref())?)
    }

    /// The interpreter that was named.
    pub fn python(&self) -> Option<&Path> {
        self.python.as_deref()
    }

    /// Opens the library; where nobody named one and none is found, says that it is left out and what would help.
    ///
    /// # Errors
    /// The interpreter or the library that was named has none.
    pub fn open_or_note(
        &self,
        left_out: &str,
    ) -> Result<Option<&'static dyn OnnxRuntimeEngine>, Failure> {
        let is_named = self.python.is_some() || std::env::var_os("ORT_DYLIB_PATH").is_some();
        match self.open() {
            Ok(runtime) => Ok(Some(runtime)),
            Err(error) if is_named => Err(error),
            Err(error) => {
                tell!("note: {left_out}: {}", error.message);
                Ok(None)
            }
        }
    }
}

impl From<OnnxRuntimeError> for Failure {
    fn from(error: OnnxRuntimeError) -> Self {
        Self::new(Exit::NotRunning, error.to_string())
    }
}
