//! When agents are allocated to subtasks.

use serde::{Deserialize, Serialize};

/// The subtask of an agent that has none.
pub const UNASSIGNED: u8 = u8::MAX;

/// When agents are allocated anew: in the first state of an episode, then after a number of steps or
/// once the open tasks changed.
///
/// Ask once in every state that is not final. The count restarts at each decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecisionPoints {
    action_length: u32,
    steps_since: Option<u32>,
}

impl DecisionPoints {
    /// Steps between decisions in the dissertation's experiments (section 7.4).
    pub const ACTION_LENGTH: u32 = 5;

    /// Decisions `action_length` steps apart, unless tasks change.
    pub const fn every(action_length: u32) -> Self {
        Self { action_length, steps_since: None }
    }

    /// Starts a new episode: its first state is a decision point.
    pub fn restart(&mut self) {
        self.steps_since = None;
    }

    /// Whether this state is a decision point; `tasks_changed` is about the step that led to it.
    pub fn is_due(&mut self, tasks_changed: bool) -> bool {
        let steps = self.steps_since.map(|steps| steps + 1);
        let due = steps.is_none_or(|steps| tasks_changed || steps >= self.action_length);
        self.steps_since = Some(if due { 0 } else { steps.unwrap_or(0) });
        due
    }
}

impl Default for DecisionPoints {
    fn default() -> Self {
        Self::every(Self::ACTION_LENGTH)
    }
}
