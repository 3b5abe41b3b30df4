//! Who works on which building, and when that is decided.

use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::coordinated::coordinated_allocation;
use super::heuristic::heuristic_allocation;
use super::state::City;
use crate::decisions::UNASSIGNED;
use crate::random::member;
use crate::spec::Rule;

/// A rule that assigns agents to buildings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AllocationRule {
    /// Every agent an open building, uniformly and independently.
    Random,
    /// Every agent for itself: the nearest building of the sort it prefers.
    Heuristic,
    /// One agent after the other, by travel time, urgency and who is there already.
    Coordinated,
}

/// The rules as command lines name them, the usual one first.
pub(super) const RULES: [(Rule, AllocationRule); 3] = [
    (
        Rule {
            name: "coordinated",
            about: "One agent after the other, by travel time, urgency and who is there already",
        },
        AllocationRule::Coordinated,
    ),
    (
        Rule {
            name: "heuristic",
            about: "Every agent for itself, the nearest subtask of the kind it prefers",
        },
        AllocationRule::Heuristic,
    ),
    (
        Rule { name: "random", about: "Every agent an open subtask at random" },
        AllocationRule::Random,
    ),
];

impl AllocationRule {
    /// The rule of this name.
    pub fn named(name: &str) -> Option<Self> {
        RULES.into_iter().find(|(rule, _)| rule.name == name).map(|(_, rule)| rule)
    }

    /// Writes for every agent its building, or [`UNASSIGNED`]; further entries are [`UNASSIGNED`].
    ///
    /// Only [`AllocationRule::Random`] draws from the generator.
    pub fn allocate(self, city: City<'_>, rng: &mut Xoshiro256PlusPlus, allocation: &mut [u8]) {
        match self {
            Self::Random => random_allocation(city, rng, allocation),
            Self::Heuristic => heuristic_allocation(city, allocation),
            Self::Coordinated => coordinated_allocation(city, allocation),
        }
    }
}

/// Gives every agent an open building, uniformly and independently.
pub fn random_allocation(city: City<'_>, rng: &mut Xoshiro256PlusPlus, allocation: &mut [u8]) {
    let open = city.open_tasks();
    allocation.fill(UNASSIGNED);
    for (task, _) in allocation.iter_mut().zip(city.agents) {
        *task = member(rng, open.into()).map_or(UNASSIGNED, |task| task as u8);
    }
}
