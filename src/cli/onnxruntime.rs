//! onnxruntime as judge and peer: found at run time, or said plainly that it was not.

use std::path::{Path, PathBuf};

use clap::Args;
use sortie_plans::{OnnxRuntimeEngine, OnnxRuntimeError};

use crate::failure::{Exit, Failure};
use crate::output::tell;
use crate::tools::engines;

/// Where onnxruntime is looked for.
#[derive(Clone, Debug, Args)]
pub struct OnnxRuntimeArguments {
    /// Interpreter that has the package `onnxruntime` [default: ORT_DYLIB_PATH, VIRTUAL_ENV, python3]
    #[arg(long, value_name = "PYTHON")]
    python: Option<PathBuf>,
}

impl OnnxRuntimeArguments {
    /// Opens the library.
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
