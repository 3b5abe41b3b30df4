//! Runs become bundles: networks, contract, golden observations, card and curve.

mod described;
mod measured;
mod method;
mod recorder;

pub use described::{contract, described, limits};
pub use measured::{Measured, measured_table, read_part};
pub use method::{MethodRun, draft_method};
pub use recorder::{EpisodeRecorder, Recorder};
