//! Who may assign agents to subtasks, by the names of the command line.

use clap::ValueEnum;
use sortie_envs::save_the_city::AllocationRule;

/// A hand-written rule that assigns agents to subtasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Allocation {
    /// One agent after the other, by travel time, urgency and who is there already
    Coordinated,
    /// Every agent for itself, the nearest subtask of the kind it prefers
    Heuristic,
    /// Every agent an open subtask at random
    Random,
}

impl Allocation {
    pub(crate) fn rule(self) -> AllocationRule {
        match self {
            Self::Coordinated => AllocationRule::Coordinated,
            Self::Heuristic => AllocationRule::Heuristic,
            Self::Random => AllocationRule::Random,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Coordinated => "coordinated",
            Self::Heuristic => "heuristic",
            Self::Random => "random",
        }
    }
}

/// Who assigns agents to subtasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AllocatorChoice {
    /// What the team has learned: the best allocation by a network that values teams
    Learned,
    /// One agent after the other, by travel time, urgency and who is there already
    Coordinated,
    /// Every agent for itself, the nearest subtask of the kind it prefers
    Heuristic,
    /// Every agent an open subtask at random
    Random,
}

impl AllocatorChoice {
    /// What was asked for, else the learned allocator where there is one.
    pub(crate) fn or_default(asked: Option<Self>, is_learned: bool) -> Self {
        asked.unwrap_or(if is_learned { Self::Learned } else { Self::Coordinated })
    }

    /// The rule, if it is one.
    pub(crate) fn rule(self) -> Option<AllocationRule> {
        match self {
            Self::Learned => None,
            Self::Coordinated => Some(AllocationRule::Coordinated),
            Self::Heuristic => Some(AllocationRule::Heuristic),
            Self::Random => Some(AllocationRule::Random),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Coordinated => "coordinated",
            Self::Heuristic => "heuristic",
            Self::Random => "random",
        }
    }
}
