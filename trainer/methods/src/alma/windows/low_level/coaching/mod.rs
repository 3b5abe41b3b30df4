//! How a coach learns what to tell its players.
//!
//! A recognition network that is of use in training only guesses the strategy back from what the agents
//! see and do, so that strategies differ where actions do, and a term keeps the coach from telling with
//! certainty too early.

mod input;
mod learning;
mod loss;
mod strategies;
#[cfg(test)]
mod tests;

pub use input::state_input;
pub use learning::Coaching;
pub(super) use learning::Told;
pub(super) use loss::{CoachLane, Guess};
pub(super) use strategies::Held;

use serde::{Deserialize, Serialize};

/// Whether there is a coach, and how it learns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoachConfig {
    /// Whether a coach tells the agents, which have no subtasks then.
    pub enabled: bool,
    /// Weight of the recognition's term of the loss; the term of the coach's entropy weighs a tenth.
    pub beta: f32,
}

impl Default for CoachConfig {
    fn default() -> Self {
        Self { enabled: false, beta: 5e-5 }
    }
}
