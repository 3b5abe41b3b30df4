//! What a finished run is worth.

use serde::Serialize;

use crate::evaluate::Evaluation;

/// Greedy episodes of the averaged weights at the end of a run, never used during the run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunResult {
    /// Environment and scenario set.
    pub env: String,
    /// Who allocated.
    pub allocation: String,
    /// Seed of the episodes, the same for all runs.
    pub seed: u64,
    /// How the team did.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}
