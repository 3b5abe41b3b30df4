//! What the agents and the allocator learn from.

use serde::{Deserialize, Serialize};

use super::require;
use sortie_learn::LearnError;

/// What is kept and how much of it an update sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplayConfig {
    /// Samples kept: records of one step and one building's team, or decisions of the allocator.
    pub capacity: usize,
    /// Samples in an update.
    pub batch: usize,
    /// Environment steps from one update to the next.
    pub steps_per_update: u64,
    /// Samples that must be there before the first update.
    pub warm_up: usize,
    /// Whether every drawn sample is turned and mirrored at random, which changes no truth.
    pub symmetries: bool,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            capacity: 1_000_000,
            batch: 512,
            steps_per_update: 16,
            warm_up: 2_000,
            symmetries: true,
        }
    }
}

impl ReplayConfig {
    /// Refuses values that do not go together; `of` names the section.
    pub(crate) fn check(&self, of: &str) -> Result<(), LearnError> {
        require(
            self.capacity >= self.warm_up,
            &format!("`{of}.capacity` must be at least `{of}.warm_up`"),
        )
    }
}
