//! Who works on which building, and when that is decided.

use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::coordinated::coordinated_allocation;
use super::heuristic::heuristic_allocation;
use super::state::{City, UNASSIGNED};
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
    /// Steps between decisions in the dissertation's experiments with SaveTheCity.
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
