//! Everything that decides how the allocator learns.

use serde::{Deserialize, Serialize};

use super::input::COLUMNS;
use crate::error::LearnError;
use crate::methods::alma::UtilityShape;
use crate::methods::alma::config::{EnvironmentConfig, NetworkConfig, require};

/// The configuration of a run that learns the allocator for agents that learn no more.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TeamValueConfig {
    /// The world to learn in.
    pub environment: EnvironmentConfig,
    /// When agents are allocated, and to what teams.
    pub decisions: DecisionConfig,
    /// Sizes of the team-value network.
    pub network: NetworkConfig,
    /// How much the allocations differ from the best known.
    pub behaviour: BehaviourConfig,
    /// What is kept and how much of it an update sees.
    pub replay: SegmentReplayConfig,
    /// How the weights follow the gradient.
    pub optimiser: TeamValueOptimiserConfig,
    /// How long to learn, and when to measure.
    pub run: TeamValueRunConfig,
}

/// When agents are allocated, and to what teams.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DecisionConfig {
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
    /// Largest team of one building.
    pub team_max: usize,
    /// Discount per environment step.
    pub discount: f32,
}

impl Default for DecisionConfig {
    fn default() -> Self {
        Self { interval: 5, team_max: 5, discount: 0.99 }
    }
}

/// How much the allocations differ from the best known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BehaviourConfig {
    /// Decisions at the start that hand-written rules make, coordinated or heuristic with equal chance.
    pub rule_decisions: u64,
    /// Share of the agents that are moved to a random open building in a rule's decision.
    pub rule_moved: f64,
    /// The same in a decision of the network.
    pub moved: f64,
    /// Share of the decisions in which agents are moved at all.
    pub moved_decisions: f64,
}

impl Default for BehaviourConfig {
    fn default() -> Self {
        Self { rule_decisions: 3_000, rule_moved: 0.3, moved: 0.15, moved_decisions: 0.7 }
    }
}

/// What is kept and how much of it an update sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentReplayConfig {
    /// Decisions kept.
    pub capacity: usize,
    /// Decisions in an update; each counts once per open building.
    pub batch: usize,
    /// Decisions from one update to the next.
    pub decisions_per_update: u64,
    /// Decisions that must be there before the first update.
    pub warm_up: usize,
    /// Whether every sampled decision is turned and mirrored at random, which changes no truth.
    pub symmetries: bool,
}

impl Default for SegmentReplayConfig {
    fn default() -> Self {
        Self {
            capacity: 60_000,
            batch: 128,
            decisions_per_update: 4,
            warm_up: 1_000,
            symmetries: true,
        }
    }
}

/// How the weights follow the gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TeamValueOptimiserConfig {
    /// Learning rate of Adam at the first decision.
    pub learning_rate: f32,
    /// Learning rate at the last decision; in between it goes in a straight line.
    pub learning_rate_end: f32,
    /// Added to Adam's denominator.
    pub epsilon: f32,
    /// Largest norm of the gradient.
    pub clip: f32,
    /// Share of the way that the target network moves towards the weights in an update.
    pub target_rate: f32,
    /// Share of the way that the averaged weights move, which are evaluated and shipped.
    pub average_rate: f32,
}

impl Default for TeamValueOptimiserConfig {
    fn default() -> Self {
        Self {
            learning_rate: 1e-3,
            learning_rate_end: 1e-4,
            epsilon: 1e-5,
            clip: 10.0,
            target_rate: 0.01,
            average_rate: 0.001,
        }
    }
}

/// How long to learn, and when to measure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TeamValueRunConfig {
    /// Decisions to learn for.
    pub decisions: u64,
    /// Decisions from one evaluation to the next.
    pub evaluate_every: u64,
    /// Greedy episodes of an evaluation.
    pub evaluate_episodes: usize,
}

impl Default for TeamValueRunConfig {
    fn default() -> Self {
        Self { decisions: 80_000, evaluate_every: 10_000, evaluate_episodes: 500 }
    }
}

impl TeamValueConfig {
    /// The network's shape: one output, the value.
    pub fn shape(&self) -> UtilityShape {
        UtilityShape { input: COLUMNS, ..self.network.shape(1) }
    }

    /// Reads a configuration; what is missing keeps its default.
    pub fn from_toml(text: &str) -> Result<Self, LearnError> {
        let config: Self =
            toml::from_str(text).map_err(|error| LearnError::Config(error.message().to_owned()))?;
        config.check()?;
        Ok(config)
    }

    /// The configuration as a file that a person can read.
    pub fn to_toml(&self) -> Result<String, LearnError> {
        toml::to_string(self).map_err(|error| LearnError::Config(error.to_string()))
    }

    /// Refuses values that cannot work.
    pub fn check(&self) -> Result<(), LearnError> {
        let Self { environment, decisions, network, behaviour, replay, run, .. } = self;
        environment.check()?;
        require(decisions.interval > 0, "`decisions.interval` must be at least 1")?;
        require(decisions.team_max > 0, "`decisions.team_max` must be at least 1")?;
        require((0.0..=1.0).contains(&decisions.discount), "`decisions.discount` must be in 0..1")?;
        network.check()?;
        let shares = [behaviour.rule_moved, behaviour.moved, behaviour.moved_decisions];
        require(
            shares.iter().all(|share| (0.0..=1.0).contains(share)),
            "the shares of `behaviour` must be in 0..1",
        )?;
        require(
            replay.batch > 0 && replay.decisions_per_update > 0 && replay.warm_up > 0,
            "`replay.batch`, `replay.decisions_per_update` and `replay.warm_up` must be at least 1",
        )?;
        require(
            replay.capacity >= replay.warm_up,
            "`replay.capacity` must be at least `replay.warm_up`",
        )?;
        require(run.evaluate_every > 0, "`run.evaluate_every` must be at least 1")?;
        require(run.evaluate_episodes > 0, "`run.evaluate_episodes` must be at least 1")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_written_file_reads_back() {
        let config = TeamValueConfig::default();
        let text = config.to_toml().unwrap();
        assert_eq!(TeamValueConfig::from_toml(&text).unwrap(), config, "{text}");
        assert_eq!(TeamValueConfig::from_toml("").unwrap(), config);
    }

    #[test]
    fn impossible_values_are_refused_by_name() {
        for (text, name) in [
            ("[decisions]\nteam_max = 0", "`decisions.team_max`"),
            ("[network]\nheads = 3", "`network.width`"),
            ("[behaviour]\nmoved = 2.0", "`behaviour`"),
            ("[replay]\ncapacity = 10", "`replay.capacity`"),
            ("[replay]\nbatches = 10", "batches"),
        ] {
            let error = TeamValueConfig::from_toml(text).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
