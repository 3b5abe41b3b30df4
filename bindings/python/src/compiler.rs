//! ONNX files read by the program that the package carries, in a process of its own, and what a plan is made of: a file's
//! path, or bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes};
use serde_json::{Value, json};
use sortie_bundle::files::{Durability, replace_file};
use sortie_core::plan::Profile;
use sortie_plans::{CompileOptions, Compiled, CompilerProcess, PolicyOptions, read_plan_or_onnx};

use crate::errors::{exceptions, of_file, within, words};

/// Why the profile int8 is left to the command line.
const UNJUDGED: &str = "an int8 plan is judged by recorded observations: make it with `sortie compile --profile int8 --npz FILE`, and open the plan";

/// What is said about a file beside itself.
pub(crate) struct Asked {
    profile: Profile,
    policy: PolicyOptions,
}

impl Asked {
    pub(crate) fn new(
        profile: &str,
        outputs: Vec<String>,
        sizes: BTreeMap<String, usize>,
        states: Vec<String>,
        available: Option<String>,
    ) -> PyResult<Self> {
        let profile = match profile {
            "exact" => Profile::Exact,
            "fused" => Profile::Fused,
            "int8" => return Err(PyValueError::new_err(UNJUDGED)),
            _ => return Err(PyValueError::new_err("profile is `exact` or `fused`")),
        };
        if let Some((name, _)) = sizes.iter().find(|(_, size)| **size == 0) {
            return Err(PyValueError::new_err(format!(
                "the size `{name}` is a whole number from 1"
            )));
        }
        let sizes = sizes.into_iter().collect();
        let policy =
            PolicyOptions { outputs, sizes, states, available, ..PolicyOptions::default() };
        Ok(Self { profile, policy })
    }

    /// Refuses what only an ONNX file can be asked for.
    pub(crate) fn check_nothing(&self, source: &Source) -> PyResult<()> {
        if self.policy == PolicyOptions::default() && self.profile == Profile::Exact {
            return Ok(());
        }
        let refusal = "this is a plan: profile, outputs, sizes, states and available were decided when it was compiled";
        Err(PyValueError::new_err(source.said(refusal.to_owned())))
    }

    /// Has a plan made, while Python's other threads go on.
    pub(crate) fn compile(&self, py: Python<'_>, source: &Source) -> PyResult<Compiled> {
        let compiler = carried(py)?;
        let options = CompileOptions { profile: self.profile, ..CompileOptions::default() };
        let compiled = py.detach(|| compiler.compile_policy(&source.bytes, &self.policy, &options));
        match compiled {
            Ok(policy) => Ok(policy.compiled),
            Err(error) => Err(exceptions::CompileError::new_err(source.said(words(&error)))),
        }
    }
}

/// The program that the package carries; the error says what helps where it carries none.
pub(crate) fn carried(py: Python<'_>) -> PyResult<CompilerProcess> {
    let program = py.import("sortie._compiler")?.call_method0("program")?;
    Ok(CompilerProcess::new(program.extract::<PathBuf>()?, ["compiler"]))
}

/// Where that program lies, or would.
pub(crate) fn program(py: Python<'_>) -> PyResult<PathBuf> {
    py.import("sortie._compiler")?.getattr("PROGRAM")?.extract()
}

/// Values as Python's own.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

/// Compiles a policy's ONNX file and writes its plan. Returns what is known of the plan.
#[pyfunction]
#[pyo3(signature = (onnx, out, profile="exact", *, outputs=Vec::new(), sizes=BTreeMap::new(), states=Vec::new(), available=None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn compile<'py>(
    py: Python<'py>,
    onnx: &Bound<'py, PyAny>,
    out: PathBuf,
    profile: &str,
    outputs: Vec<String>,
    sizes: BTreeMap<String, usize>,
    states: Vec<String>,
    available: Option<String>,
) -> PyResult<Bound<'py, PyAny>> {
    let asked = Asked::new(profile, outputs, sizes, states, available)?;
    let Compiled { bytes, report } = asked.compile(py, &Source::read(onnx)?)?;
    let written = py.detach(|| replace_file(&out, &bytes, Durability::Cached));
    written.map_err(|error| of_file(&out, &error))?;
    to_python(py, &json!(report))
}

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
        let bytes = given
            .py()
            .detach(|| read_plan_or_onnx(&path))
            .map_err(|error| of_file(&path, &error))?;
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
