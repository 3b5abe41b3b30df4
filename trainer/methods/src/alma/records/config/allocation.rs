//! Who assigns agents to buildings, and how that is learned.

use serde::{Deserialize, Serialize};
use sortie_envs::Spec;

use super::{NetworkConfig, OptimiserConfig, ReplayConfig, require};
use crate::alma::agents::UtilityShape;
use crate::alma::records::team_columns::TeamColumns;
use crate::alma::teams::Allocation;
use sortie_learn::LearnError;

/// Who assigns agents to buildings. A training episode draws its allocator by these weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AllocationConfig {
    /// Weight of the allocator that the run learns. With 0 the run learns none.
    pub learned: f64,
    /// Weight of the hand-written rule that looks at the whole team.
    pub coordinated: f64,
    /// Weight of the reference's heuristic.
    pub heuristic: f64,
    /// Weight of uniform assignment.
    pub random: f64,
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
    /// Largest team that the learned allocator sends to one building.
    pub team_max: usize,
}

impl Default for AllocationConfig {
    fn default() -> Self {
        Self {
            learned: 1.0,
            coordinated: 0.0,
            heuristic: 0.0,
            random: 0.0,
            interval: 5,
            team_max: 5,
        }
    }
}

impl AllocationConfig {
    /// The allocators with their weights.
    pub fn weights(&self) -> [(Allocation, f64); 4] {
        [
            (Allocation::Learned, self.learned),
            (Allocation::Coordinated, self.coordinated),
            (Allocation::Heuristic, self.heuristic),
            (Allocation::Random, self.random),
        ]
    }

    /// Whether the run learns an allocator.
    pub fn is_learned(&self) -> bool {
        self.learned > 0.0
    }

    /// Who allocates where the run is measured: the learned allocator, else the rule of most weight.
    pub fn measured(&self) -> Allocation {
        if self.is_learned() {
            return Allocation::Learned;
        }
        let heavier = |a: (Allocation, f64), b: (Allocation, f64)| if b.1 > a.1 { b } else { a };
        self.weights().into_iter().reduce(heavier).map_or(Allocation::Learned, |(who, _)| who)
    }

    pub(crate) fn check(&self) -> Result<(), LearnError> {
        let weights = self.weights();
        require(
            weights.iter().any(|(_, weight)| *weight > 0.0),
            "one of the weights of `allocation` must be positive",
        )
    }
}

/// How the allocator learns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AllocatorConfig {
    /// Environment steps before it learns. Until then the coordinated rule decides in its stead: the
    /// first agents wander and teach nothing about teams.
    pub learns_from: u64,
    /// Environment steps before it decides. From `learns_from` until then an episode is decided by the
    /// coordinated rule or the heuristic, with equal chance.
    pub decides_from: u64,
    /// Discount per environment step.
    pub discount: f32,
    /// Share of the agents that are moved to a random open building in a decision to explore.
    pub moved: f64,
    /// Share of the decisions in which agents are moved at all.
    pub moved_decisions: f64,
    /// Sizes of the team-value network.
    pub network: NetworkConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
}

impl Default for AllocatorConfig {
    fn default() -> Self {
        Self {
            learns_from: 120_000,
            decides_from: 150_000,
            discount: 0.99,
            moved: 0.15,
            moved_decisions: 0.7,
            network: NetworkConfig::default(),
            replay: ReplayConfig {
                capacity: 60_000,
                batch: 256,
                warm_up: 1_000,
                ..ReplayConfig::default()
            },
            optimiser: OptimiserConfig {
                learning_rate_end: 1e-4,
                decay_from: 0.0,
                average_rate: 0.001,
                ..OptimiserConfig::default()
            },
        }
    }
}

impl AllocatorConfig {
    /// The network's shape in an environment: one output, the value.
    pub fn shape(&self, spec: &Spec) -> UtilityShape {
        self.network.shape(TeamColumns::of(spec).count(), 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_measured_under_what_it_learns_or_mostly_sees() {
        let mut allocation = AllocationConfig { coordinated: 3.0, ..AllocationConfig::default() };
        assert_eq!(allocation.measured(), Allocation::Learned);
        allocation.learned = 0.0;
        allocation.heuristic = 1.0;
        assert_eq!(allocation.measured().name(), "coordinated");
        allocation.random = 4.0;
        assert_eq!(allocation.measured().name(), "random");
    }
}
