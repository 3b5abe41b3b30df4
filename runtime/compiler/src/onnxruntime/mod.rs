//! The source graph run by onnxruntime: a judge beside tract, and the peer of benchmarks.
//!
//! Nothing is linked: the library of the PyPI wheel `onnxruntime` is opened at run time, once in a process.
//! Sessions run on one thread, with all of onnxruntime's optimisations.

mod batched_graph;
mod session;

use std::env;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use sortie_plans::{CompileError, OnnxRuntimeError};

pub use batched_graph::{batched_agents_onnx, batched_team_values_onnx};
pub(crate) use session::SessionEngine;

/// The library, opened.
#[derive(Clone, Debug)]
pub struct OnnxRuntime {
    version: String,
}

impl OnnxRuntime {
    /// Opens a library. A process has only one: the first that is asked for stays.
    pub fn load(library: &Path) -> Result<&'static Self, OnnxRuntimeError> {
        static LOADED: OnceLock<Result<OnnxRuntime, OnnxRuntimeError>> = OnceLock::new();
        LOADED.get_or_init(|| Self::open(library)).as_ref().map_err(Clone::clone)
    }

    fn open(library: &Path) -> Result<Self, OnnxRuntimeError> {
        let unusable = |reason: String| OnnxRuntimeError::Unusable { reason };
        let open = || ort::init_from(library.display()).with_telemetry(false).commit();
        // The binding panics where the library is too old or none at all.
        let opened = catch_unwind(AssertUnwindSafe(open));
        let too_old = || format!("{} is too old, or none", library.display());
        opened.map_err(|_| unusable(too_old()))?.map_err(|error| unusable(error.to_string()))?;
        let name = library.file_name().unwrap_or_default().to_string_lossy();
        let version = name.split_once(".so.").map_or("of unknown version", |(_, version)| version);
        Ok(Self { version: version.to_owned() })
    }

    /// The version, as the library's file name has it.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Reads a graph; that the library is open is what `self` stands for.
    fn session(&self, onnx: &[u8]) -> Result<Session, CompileError> {
        let build = || -> ort::Result<Session> {
            Session::builder()?
                .with_optimization_level(GraphOptimizationLevel::Level3)?
                .with_intra_threads(1)?
                .with_inter_threads(1)?
                .commit_from_memory(onnx)
        };
        build().map_err(refused)
    }
}

fn refused(error: ort::Error) -> CompileError {
    CompileError::Run { reason: error.to_string() }
}

/// Prints the folder of the installed package, and imports nothing.
const PROGRAM: &str = "import importlib.util as u; s = u.find_spec('onnxruntime'); \
                       print(s.submodule_search_locations[0] if s else '')";

/// Finds the library: in the environment of `python` if that is given, else by `ORT_DYLIB_PATH`, in the
/// virtual environment of `VIRTUAL_ENV`, or with the `python3` of `PATH`.
///
/// # Errors
/// None of these has it; the message says what helps.
pub fn find_library(python: Option<&Path>) -> Result<PathBuf, OnnxRuntimeError> {
    let named = |name: &str| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(python) = python {
        return in_package_of(python).ok_or_else(|| missing(format!("by {}", python.display())));
    }
    if let Some(library) = named("ORT_DYLIB_PATH") {
        let exists = library.is_file();
        let place = format!("at ORT_DYLIB_PATH, {}", library.display());
        return if exists { Ok(library) } else { Err(missing(place)) };
    }
    let own = named("VIRTUAL_ENV").map(|folder| folder.join("bin/python3"));
    let found = own.as_deref().and_then(in_package_of);
    let found = found.or_else(|| in_package_of(Path::new("python3")));
    found.ok_or_else(|| missing("by python3".to_owned()))
}

fn missing(place: String) -> OnnxRuntimeError {
    OnnxRuntimeError::NotFound { place }
}

/// The library in the package that an interpreter would import.
fn in_package_of(python: &Path) -> Option<PathBuf> {
    let answer = Command::new(python).args(["-c", PROGRAM]).output().ok()?;
    let package = String::from_utf8(answer.stdout).ok()?;
    library_in(&Path::new(package.trim()).join("capi"))
}

/// `libonnxruntime.so`, usually with a version behind.
fn library_in(folder: &Path) -> Option<PathBuf> {
    let files = folder.read_dir().ok()?.flatten().map(|entry| entry.path());
    let is_library = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("libonnxruntime.so")
    };
    files.filter(is_library).max()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_library_of_a_package_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(library_in(folder.path()), None);
        for name in ["libonnxruntime.so.1.30.0", "libonnxruntime.so.1.31.1", "other.so.2"] {
            std::fs::write(folder.path().join(name), []).unwrap();
        }
        assert_eq!(library_in(folder.path()), Some(folder.path().join("libonnxruntime.so.1.31.1")));
    }

    #[test]
    fn an_interpreter_without_the_package_is_named_with_what_helps() {
        let error = find_library(Some(Path::new("/nowhere/bin/python3"))).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("by /nowhere/bin/python3"), "{message}");
        assert!(message.contains("pip install onnxruntime"), "{message}");
    }
}
