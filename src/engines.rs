//! Engines that run ONNX graphs, which one of two programs links: `sortie-tract`.
//!
//! tract takes most of a first build, and a team whose bundle ships its plans needs none of it. So `sortie` does
//! without, and where an engine is asked for becomes `sortie-tract`, which lies beside it and takes the same words.

use std::env;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use sortie_plans::{CompileError, Engines};

use crate::failure::{Failure, Outcome};

/// The program that links them.
const PROGRAM: &str = "sortie-tract";

static LINKED: OnceLock<&'static dyn Engines> = OnceLock::new();

/// Makes the engines of this program known, once.
pub(crate) fn link(engines: &'static dyn Engines) {
    // A second call would come from a second `main`.
    let _ = LINKED.set(engines);
}

/// The engines of this program; where it has none, the program that has them goes on in its place.
pub(crate) fn engines() -> Result<&'static dyn Engines, Failure> {
    match LINKED.get() {
        Some(engines) => Ok(*engines),
        None => Err(become_linked()),
    }
}

/// The program that links the engines: this one, or the one beside it.
pub(crate) fn program() -> PathBuf {
    if LINKED.get().is_some() {
        // Whatever becomes of the file: a build may replace it while this program runs.
        return PathBuf::from("/proc/self/exe");
    }
    env::current_exe().unwrap_or_default().with_file_name(PROGRAM)
}

/// Fails early where [`program`] is missing: before anything is computed for it.
pub(crate) fn check_program() -> Outcome {
    let program = program();
    match program.metadata() {
        Ok(_) => Ok(()),
        Err(error) => Err(CompileError::not_started(program, &error).into()),
    }
}

/// Goes on as the program with engines; returns only where that cannot be started.
fn become_linked() -> Failure {
    let program = program();
    let error = Command::new(&program).args(env::args_os().skip(1)).exec();
    Failure::from(CompileError::not_started(program, &error))
}
