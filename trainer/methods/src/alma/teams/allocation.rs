//! Who allocates, by name.

use serde::{Deserialize, Serialize};

use super::allocators::RuleAllocator;

/// Who allocates in an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Allocation {
    /// The allocator of the run.
    Learned,
    /// The environment's rule that looks at the whole team.
    Coordinated,
    /// The reference's heuristic.
    Heuristic,
    /// Chance.
    Random,
}

impl Allocation {
    const ALL: [Self; 4] = [Self::Learned, Self::Coordinated, Self::Heuristic, Self::Random];

    /// The allocator of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|allocation| allocation.name() == name)
    }

    /// Its name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Coordinated => "coordinated",
            Self::Heuristic => "heuristic",
            Self::Random => "random",
        }
    }

    /// The environment's rule of this name.
    pub fn allocator(self) -> RuleAllocator {
        RuleAllocator(self.name())
    }
}
