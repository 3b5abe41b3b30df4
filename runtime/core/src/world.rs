//! The environment or robot side that a team acts in.

pub use crate::shape::Shape;

use crate::wire::FrameMut;

/// What a step did to the episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepOutcome {
    /// The episode ended with this step.
    pub episode_ended: bool,
    /// The set of finished subtasks changed in this step, so that agents are to be allocated anew.
    pub tasks_changed: bool,
}

/// A world refused a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnavailableAction {
    /// The agent whose action was not available.
    pub agent: usize,
    /// That action.
    pub action: u16,
}

/// What the team acts in. One episode after the other: `reset`, then `observe` and `step` until it ends.
pub trait World {
    /// The padded sizes, constant for the world's life.
    fn shape(&self) -> Shape;

    /// Starts the next episode.
    fn reset(&mut self);

    /// Writes features, `present`, `observable`, `available`, open subtasks, and the subtask of every
    /// entity that is not an agent. Last actions and the agents' subtasks are the world role's to write.
    fn observe(&self, frame: &mut FrameMut<'_>);

    /// Applies one action `[A]` per agent. Agents that are not present, or whose entry is
    /// [`NO_ACTION`](crate::NO_ACTION) because none is available to them, do nothing.
    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction>;
}
