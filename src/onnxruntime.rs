//! onnxruntime as judge and peer: found at run time, or said plainly that it was not.

use std::path::{Path, PathBuf};

use clap::Args;
use sortie_plans::{OnnxRuntimeEngine, OnnxRuntimeError};

use crate::engines::engines;
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
    pub(crate) fn open(&self) -> Result<&'static dyn OnnxRuntimeEngine, Failure> {
        Ok(engines()?.onnxruntime(self.python.as_deref())?)
    }

    /// The interpreter that was named.
    pub(crate) fn python(&self) -> Option<&Path> {
        self.python.as_deref()
    }

    /// Opens the library, or says that it is left out and what would help.
    pub(crate) fn open_or_note(&self, left_out: &str) -> Option<&'static dyn OnnxRuntimeEngine> {
        let opened = self.open();
        opened.inspect_err(|Failure { message, .. }| tell!("note: {left_out}: {message}")).ok()
    }
}

impl From<OnnxRuntimeError> for Failure {
    fn from(error: OnnxRuntimeError) -> Self {
        Self::new(Exit::NotRunning, error.to_string())
    }
}
