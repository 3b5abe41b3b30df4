//! How long a run learns, and when it measures and saves.

use serde::{Deserialize, Serialize};

/// How long to learn, and when to measure and save.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunConfig {
    /// Folder of a run whose averaged weights this one begins with; empty for a run from scratch.
    pub from: String,
    /// Instructions of matrix products: `widest`, or the name of one of
    /// [`Products`](sortie_nn::layers::products::Products).
    pub products: String,
    /// Environment steps to learn for.
    pub steps: u64,
    /// Environment steps from one evaluation to the next.
    pub evaluate_every: u64,
    /// Greedy episodes of an evaluation.
    pub evaluate_episodes: usize,
    /// Greedy episodes of the evaluation at the end of the run, fresh ones that were never used before.
    pub final_episodes: usize,
    /// Minutes from one checkpoint to the next; one is always written at the end.
    pub checkpoint_minutes: f64,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            from: String::new(),
            products: "widest".to_owned(),
            steps: 600_000,
            evaluate_every: 50_000,
            evaluate_episodes: 500,
            final_episodes: 2_000,
            checkpoint_minutes: 5.0,
        }
    }
}
