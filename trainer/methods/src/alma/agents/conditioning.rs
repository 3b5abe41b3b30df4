//! What an agent sees of the subtasks.

use serde::{Deserialize, Serialize};

/// How agents and mixer are conditioned on subtasks (dissertation section 7.3 and the comparisons of
/// figure 7.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Conditioning {
    /// An agent sees its own team and building only: ALMA.
    #[default]
    Mask,
    /// An agent sees everything, each entity marked with its subtask: "no mask".
    Input,
    /// There are no subtasks: everybody sees everything and earns the whole team's reward.
    None,
}

impl Conditioning {
    /// As the configuration has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mask => "mask",
            Self::Input => "input",
            Self::None => "none",
        }
    }

    /// Whether teams work on subtasks of their own.
    pub fn has_subtasks(self) -> bool {
        self != Self::None
    }

    /// Columns that mark an entity's subtask, where there are at most so many of them.
    pub fn task_columns(self, tasks: usize) -> usize {
        if self == Self::Input { tasks } else { 0 }
    }
}
