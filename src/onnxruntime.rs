//! onnxruntime as judge and peer: found at run time, or said plainly that it was not.

use std::path::{Path, PathBuf};

use clap::Args;
use sortie_compiler::onnxruntime::{OnnxRuntime, OnnxRuntimeError, find_library};

use crate::failure::{Exit, Failure};
use crate::output::tell;

/// Where onnxruntime is looked for.
#[derive(Clone, Debug, Args)]
pub(crate) struct OnnxRuntimeArguments {
    /// Interpreter that has the package `onnxruntime` [default: ORT_DYLIB_PATH, VIRTUAL_ENV, python3]
    #[arg(long, value_name = "PYTHON")]
    python: Option<PathBuf>,
}

impl OnnxRuntimeArguments {
    /// Opens the library.
    pub(crate) fn open(&self) -> Result<&'static OnnxRuntime, OnnxRuntimeError> {
        open(self.python.as_deref())
    }

    /// The interpreter that was named.
    pub(crate) fn python(&self) -> Option<&Path> {
        self.python.as_deref()
    }

    /// Opens the library, or says that it is left out and what would help.
    pub(crate) fn open_or_note(&self, left_out: &str) -> Option<&'static OnnxRuntime> {
        self.open().inspect_err(|error| tell!("note: {left_out}: {error}")).ok()
    }
}

fn open(python: Option<&Path>) -> Result<&'static OnnxRuntime, OnnxRuntimeError> {
    OnnxRuntime::load(&find_library(python)?)
}

impl From<OnnxRuntimeError> for Failure {
    fn from(error: OnnxRuntimeError) -> Self {
        Self::new(Exit::NotRunning, error.to_string())
    }
}
