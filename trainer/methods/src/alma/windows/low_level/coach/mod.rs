//! COPA (coach-player): flat players and a coach that sees everything and tells each of them a strategy.
//!
//! The baseline of dissertation section 7.5, after its public code. At decision points the coach draws a
//! vector for every agent, its strategy, which is added before the head of the agent's utility network
//! until the next decision; before the first it is zero. Where a team is measured the mean is told. A
//! recognition network that is of use in training only guesses the strategy back from what the agents
//! see and do, so that strategies differ where actions do, and a term keeps the coach from telling with
//! certainty too early.

mod advice;
mod gaussian;
mod input;
mod learning;
mod loss;
mod networks;
mod passes;
mod players;
mod strategies;
#[cfg(test)]
mod tests;
mod trunk;

pub use advice::Advice;
pub(crate) use advice::strategy_of;
pub use gaussian::drawn;
pub use input::{seen_input, state_input};
pub use learning::Coaching;
pub(super) use learning::Told;
pub(super) use loss::{CoachLane, Guess};
pub use networks::{Coach, CoachShape, Recognition, RecognitionShape};
pub use passes::{CoachPass, RecognitionPass};
pub use players::PlayerPass;
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
