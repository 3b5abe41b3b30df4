//! How much is tried out while learning.

/// How much is tried out in a round.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exploration {
    /// How often an agent takes a random available action.
    pub actions: f32,
    /// How often a decision takes the first proposal instead of the critic's best.
    pub proposal: f32,
    /// How often an agent is given a random open subtask at a decision.
    pub allocation: f32,
}
