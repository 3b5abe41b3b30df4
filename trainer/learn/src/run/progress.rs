//! How a run goes, for whoever watches it.

use std::path::Path;

use super::{CurvePoint, RunResult, TrainingPoint};

/// Is told how a run goes.
pub trait Observer {
    /// Some steps were taken; called several hundred times a second.
    fn progress(&mut self, progress: &Progress) {
        let _ = progress;
    }

    /// Training went on for a while.
    fn trained(&mut self, point: &TrainingPoint) {
        let _ = point;
    }

    /// An evaluation was made.
    fn evaluated(&mut self, point: &CurvePoint) {
        let _ = point;
    }

    /// A checkpoint was written.
    fn saved(&mut self, checkpoint: &Path) {
        let _ = checkpoint;
    }

    /// The run has ended and was measured on fresh episodes.
    fn finished(&mut self, result: &RunResult) {
        let _ = result;
    }
}

/// Listens to nothing.
impl Observer for () {}

/// How far a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Environment steps taken.
    pub env_steps: u64,
    /// Environment steps of the whole run.
    pub env_steps_total: u64,
}

/// How a trainer ended its work for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps were taken.
    Finished,
    /// The stop flag was set; a checkpoint was written.
    Stopped,
}
