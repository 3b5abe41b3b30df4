//! What a plan is made of: a file's path, or bytes.

use std::path::{Path, PathBuf};

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes};
use sortie_plans::read_onnx;

use crate::errors::{of_file, within};

/// What every plan starts with.
const MAGIC: &[u8] = b"SORTIEPL";

/// A file that was read, or bytes that were given.
pub(crate) struct Source {
    pub(crate) path: Option<PathBuf>,
    pub(crate) bytes: Vec<u8>,
}

impl Source {
    pub(crate) fn read(given: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(bytes) = given.cast::<PyBytes>() {
            return Ok(Self { path: None, bytes: bytes.as_bytes().to_vec() });
        }
        if let Ok(bytes) = given.cast::<PyByteArray>() {
            return Ok(Self { path: None, bytes: bytes.to_vec() });
        }
        let path: PathBuf = given.extract().map_err(|_| {
            let kind = given.get_type();
            PyTypeError::new_err(format!(
                "expected the path or the bytes of a plan or of an ONNX file, not {kind}"
            ))
        })?;
        let bytes =
            given.py().detach(|| read_onnx(&path)).map_err(|error| of_file(&path, &error))?;
        Ok(Self { path: Some(path), bytes })
    }

    /// Whether this is a plan, or meant to be one.
    pub(crate) fn is_plan(&self) -> bool {
        let named = self.path.as_deref().and_then(Path::extension).is_some_and(|end| end == "plan");
        named || self.bytes.starts_with(MAGIC)
    }

    /// Words about it.
    pub(crate) fn said(&self, words: String) -> String {
        within(self.path.as_deref(), words)
    }
}
