//! The source graph run by onnxruntime: a judge beside tract, and the peer of benchmarks.
//!
//! Nothing is linked: the library of the PyPI wheel `onnxruntime` is opened at run time, once in a process.
//! Sessions run on one thread, with all of onnxruntime's optimisations; inputs and outputs are bound once
//! for every number of rows, so that a call writes, runs and reads.

mod agent;
mod batched_agents;
mod batched_graph;
mod batched_team_values;
mod bound_flat;
mod flat;
mod library;
mod proposals;
mod team_value;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::OnceLock;

use ort::io_binding::IoBinding;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;

use sortie_plans::{CompileError, OnnxRuntimeError};

pub use agent::OnnxRuntimePolicy;
pub use batched_agents::BatchedAgents;
pub use batched_graph::{batched_agents_onnx, batched_team_values_onnx};
pub use batched_team_values::BatchedTeamValues;
pub(crate) use flat::OnnxRuntimeFlatPolicy;
pub use library::find_library;
pub use proposals::OnnxRuntimeProposals;
pub use team_value::OnnxRuntimeTeamValue;

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

/// Runs what is bound and copies the output; none where onnxruntime refuses, or gives another number of values.
fn run_bound(session: &mut Session, binding: &IoBinding, to: &mut [f32]) -> Option<()> {
    let outputs = session.run_binding(binding).ok()?;
    let output = outputs.values().last()?;
    let (_, values) = output.try_extract_tensor::<f32>().ok()?;
    (values.len() == to.len()).then(|| to.copy_from_slice(values))
}

/// What onnxruntime said.
fn refused(error: ort::Error) -> CompileError {
    CompileError::Run { reason: error.to_string() }
}
