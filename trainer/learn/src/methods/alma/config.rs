//! Everything that decides how a run learns, in one readable file.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{AllocationRule, Constants};

use super::history::Returns;
use super::team_batch::INPUT_COLUMNS;
use super::utility::UtilityShape;
use crate::error::LearnError;
use crate::run::RunDescription;

/// The configuration of a run. Its defaults are the preset `fast`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The world to learn in.
    pub environment: EnvironmentConfig,
    /// Who assigns agents to buildings while learning.
    pub allocation: AllocationConfig,
    /// Sizes of the utility network.
    pub network: NetworkConfig,
    /// How rewards become targets.
    pub returns: ReturnsConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How much the agents try out.
    pub exploration: ExplorationConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
    /// How long to learn, and when to measure and save.
    pub run: RunConfig,
}

/// The world to learn in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvironmentConfig {
    /// Name of the environment: `save-the-city`.
    pub name: String,
    /// Scenario set.
    pub set: String,
    /// Episodes that run at the same time; one that ends restarts at once.
    pub instances: usize,
    /// Numbers of the rules.
    pub constants: Constants,
}

impl Default for EnvironmentConfig {
    fn default() -> Self {
        Self {
            name: "save-the-city".to_owned(),
            set: "2-5a_2-5b".to_owned(),
            instances: 16,
            constants: Constants::default(),
        }
    }
}

impl EnvironmentConfig {
    /// Refuses values that cannot work.
    pub(super) fn check(&self) -> Result<(), LearnError> {
        require(self.name == "save-the-city", "`environment.name` must be `save-the-city`")?;
        require(self.instances > 0, "`environment.instances` must be at least 1")
    }
}

/// Who assigns agents to buildings. An episode draws its rule by these weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AllocationConfig {
    /// Weight of the hand-written rule that looks at the whole team.
    pub coordinated: f64,
    /// Weight of the reference's heuristic.
    pub heuristic: f64,
    /// Weight of uniform assignment.
    pub random: f64,
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
}

impl Default for AllocationConfig {
    fn default() -> Self {
        Self { coordinated: 1.0, heuristic: 0.0, random: 0.0, interval: 5 }
    }
}

impl AllocationConfig {
    /// The rules with their weights.
    pub fn weights(&self) -> [(AllocationRule, f64); 3] {
        [
            (AllocationRule::Coordinated, self.coordinated),
            (AllocationRule::Heuristic, self.heuristic),
            (AllocationRule::Random, self.random),
        ]
    }
}

/// Sizes of the utility network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of embedding and attention. The dissertation has 128.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Width of the layer before the head.
    pub base: usize,
    /// Non-zero inputs that the initial weights of the first layer are sized for.
    ///
    /// PyTorch would take all columns, although rows are mostly zeros.
    pub active_inputs: f32,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self { width: 64, heads: 4, base: 64, active_inputs: 8.0 }
    }
}

impl NetworkConfig {
    /// Refuses values that cannot work.
    pub(super) fn check(&self) -> Result<(), LearnError> {
        require(
            self.heads > 0 && self.width > 0 && self.width.is_multiple_of(self.heads),
            "`network.width` must be a multiple of `network.heads`",
        )?;
        require(self.base > 0, "`network.base` must be at least 1")?;
        require(self.active_inputs > 0.0, "`network.active_inputs` must be positive")
    }

    /// The network's shape in an environment with so many actions.
    pub fn shape(&self, actions: usize) -> UtilityShape {
        UtilityShape {
            input: INPUT_COLUMNS,
            width: self.width,
            heads: self.heads,
            base: self.base,
            actions,
        }
    }
}

/// How rewards become targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReturnsConfig {
    /// Steps before a target bootstraps.
    pub steps: u32,
    /// Discount per step.
    pub discount: f32,
    /// Potential per cell between an agent and its building; 0 turns shaping off.
    ///
    /// Not in the dissertation. It leaves the best policy as it is and learning takes half as long.
    pub shaping: f32,
}

impl Default for ReturnsConfig {
    fn default() -> Self {
        Self { steps: 3, discount: 0.97, shaping: 0.5 }
    }
}

impl From<&ReturnsConfig> for Returns {
    fn from(config: &ReturnsConfig) -> Self {
        let ReturnsConfig { steps, discount, shaping } = *config;
        Self { steps, discount, shaping }
    }
}

/// What is kept and how much of it an update sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplayConfig {
    /// Records kept. A record is one step of one building's team.
    pub capacity: usize,
    /// Records in an update.
    pub batch: usize,
    /// Environment steps from one update to the next.
    pub steps_per_update: u64,
    /// Records that must be there before the first update.
    pub warm_up: usize,
    /// Whether every sampled record is turned and mirrored at random, which changes no truth.
    pub symmetries: bool,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            capacity: 1_000_000,
            batch: 512,
            steps_per_update: 16,
            warm_up: 2_000,
            symmetries: true,
        }
    }
}

/// How much the agents try out: a random available action with probability epsilon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExplorationConfig {
    /// Epsilon of the first step.
    pub start: f32,
    /// Epsilon from step `steps` on.
    pub end: f32,
    /// Environment steps of the way down.
    pub steps: u64,
    /// Factors on epsilon, dealt to the instances in turn: some act greedily, some more wildly.
    pub spread: Vec<f32>,
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self { start: 1.0, end: 0.05, steps: 60_000, spread: vec![0.0, 0.2, 1.0, 2.0] }
    }
}

/// How the weights follow the gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Learning rate of Adam.
    pub learning_rate: f32,
    /// Share of the run after which the learning rate falls linearly to 0.
    pub decay_from: f64,
    /// Added to Adam's denominator.
    pub epsilon: f32,
    /// Largest norm of the gradient.
    pub clip: f32,
    /// Share of the way that the target network moves towards the weights in an update.
    pub target_rate: f32,
    /// Share of the way that the averaged weights move, which are evaluated and shipped.
    pub average_rate: f32,
}

impl Default for OptimiserConfig {
    fn default() -> Self {
        Self {
            learning_rate: 1e-3,
            decay_from: 0.5,
            epsilon: 1e-5,
            clip: 10.0,
            target_rate: 0.01,
            average_rate: 0.0005,
        }
    }
}

/// How long to learn, and when to measure and save.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunConfig {
    /// Environment steps to learn for.
    pub steps: u64,
    /// Environment steps from one evaluation to the next.
    pub evaluate_every: u64,
    /// Greedy episodes of an evaluation.
    pub evaluate_episodes: usize,
    /// Minutes from one checkpoint to the next; one is always written at the end.
    pub checkpoint_minutes: f64,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            steps: 1_000_000,
            evaluate_every: 50_000,
            evaluate_episodes: 500,
            checkpoint_minutes: 5.0,
        }
    }
}

impl Config {
    /// A preset by name: `fast`.
    pub fn preset(name: &str) -> Result<Self, LearnError> {
        match name {
            "fast" => Ok(Self::default()),
            _ => Err(LearnError::Config(format!("no preset `{name}`; there is `fast`"))),
        }
    }

    /// Reads a configuration; what is missing keeps its default.
    ///
    /// A run's `train.toml` will do: its lines about the run itself are passed over.
    pub fn from_toml(text: &str) -> Result<Self, LearnError> {
        let bad = |error: toml::de::Error| LearnError::Config(error.message().to_owned());
        let mut table: toml::Table = text.parse().map_err(bad)?;
        for key in RunDescription::KEYS {
            table.remove(key);
        }
        let config: Self = table.try_into().map_err(bad)?;
        config.check()?;
        Ok(config)
    }

    /// The configuration as a file that a person can read.
    pub fn to_toml(&self) -> Result<String, LearnError> {
        toml::to_string(self).map_err(|error| LearnError::Config(error.to_string()))
    }

    /// Replaces one value, named as in `replay.batch=256`.
    pub fn set(&mut self, assignment: &str) -> Result<(), LearnError> {
        let bad = |why: &str| LearnError::Config(format!("`{assignment}`: {why}"));
        let (key, value) = assignment.split_once('=').ok_or_else(|| bad("not `key=value`"))?;
        let mut table = toml::Table::try_from(&*self).map_err(|e| bad(&e.to_string()))?;
        let (parents, name) = key.trim().rsplit_once('.').ok_or_else(|| bad("no such key"))?;
        let mut place = &mut table;
        for parent in parents.split('.') {
            place = place
                .get_mut(parent)
                .and_then(toml::Value::as_table_mut)
                .ok_or_else(|| bad("no such key"))?;
        }
        let old = place.get(name).ok_or_else(|| bad("no such key"))?;
        let new = parse_like(old, value.trim()).ok_or_else(|| bad("not a value of that kind"))?;
        place.insert(name.to_owned(), new);
        let changed: Self = table.try_into().map_err(|e: toml::de::Error| bad(e.message()))?;
        changed.check()?;
        *self = changed;
        Ok(())
    }

    /// Refuses values that cannot work.
    pub fn check(&self) -> Result<(), LearnError> {
        let Self { environment, allocation, network, returns, replay, .. } = self;
        environment.check()?;
        let weights = allocation.weights();
        require(
            weights.iter().all(|(_, w)| *w >= 0.0) && weights.iter().any(|(_, w)| *w > 0.0),
            "the weights of `allocation` must not be negative, and one must be positive",
        )?;
        require(allocation.interval > 0, "`allocation.interval` must be at least 1")?;
        network.check()?;
        require(returns.steps > 0, "`returns.steps` must be at least 1")?;
        require((0.0..=1.0).contains(&returns.discount), "`returns.discount` must be in 0..1")?;
        require(
            replay.batch > 0 && replay.steps_per_update > 0 && replay.warm_up > 0,
            "`replay.batch`, `replay.steps_per_update` and `replay.warm_up` must be at least 1",
        )?;
        require(
            replay.capacity >= replay.warm_up && replay.capacity <= u32::MAX as usize,
            "`replay.capacity` must be at least `replay.warm_up` and fit 32 bits",
        )?;
        require(!self.exploration.spread.is_empty(), "`exploration.spread` must not be empty")?;
        require(
            (0.0..=1.0).contains(&self.optimiser.decay_from),
            "`optimiser.decay_from` must be in 0..1",
        )?;
        require(self.run.evaluate_every > 0, "`run.evaluate_every` must be at least 1")?;
        require(self.run.evaluate_episodes > 0, "`run.evaluate_episodes` must be at least 1")
    }
}

/// Refuses a configuration that does not hold, with what it must be.
pub(super) fn require(holds: bool, what: &str) -> Result<(), LearnError> {
    if holds { Ok(()) } else { Err(LearnError::Config(what.to_owned())) }
}

/// Reads `text` as a value of the same kind as `old`.
fn parse_like(old: &toml::Value, text: &str) -> Option<toml::Value> {
    use toml::Value;
    Some(match old {
        Value::String(_) => Value::String(text.to_owned()),
        Value::Integer(_) => Value::Integer(text.replace('_', "").parse().ok()?),
        Value::Float(_) => Value::Float(text.parse().ok()?),
        Value::Boolean(_) => Value::Boolean(text.parse().ok()?),
        _ => toml::from_str::<toml::Table>(&format!("value = {text}")).ok()?.remove("value")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_written_file_reads_back() {
        let config = Config::default();
        let text = config.to_toml().unwrap();
        assert_eq!(Config::from_toml(&text).unwrap(), config, "{text}");
        assert_eq!(Config::from_toml("").unwrap(), config);
    }

    #[test]
    fn dotted_keys_replace_values_of_every_kind() {
        let mut config = Config::default();
        for assignment in [
            "environment.set=2-8a_2-8b",
            "replay.batch = 1_024",
            "optimiser.learning_rate=5e-4",
            "replay.symmetries=false",
            "exploration.spread=[0.0, 1.0]",
            "environment.constants.episode_limit=99",
        ] {
            config.set(assignment).unwrap_or_else(|error| panic!("{error}"));
        }
        assert_eq!(config.environment.set, "2-8a_2-8b");
        assert_eq!(config.replay.batch, 1024);
        assert_eq!(config.optimiser.learning_rate, 5e-4);
        assert!(!config.replay.symmetries);
        assert_eq!(config.exploration.spread, [0.0, 1.0]);
        assert_eq!(config.environment.constants.episode_limit, 99);
    }

    #[test]
    fn wrong_keys_and_values_are_refused_and_change_nothing() {
        let mut config = Config::default();
        for (assignment, part) in [
            ("replay.batsch=3", "no such key"),
            ("replay=3", "no such key"),
            ("replay.batch", "key=value"),
            ("replay.batch=many", "not a value"),
            ("replay.batch=0", "at least 1"),
            ("network.heads=5", "multiple"),
            ("allocation.coordinated=0", "positive"),
        ] {
            let error = config.set(assignment).unwrap_err().to_string();
            assert!(error.contains(part), "{assignment}: {error}");
        }
        assert_eq!(config, Config::default());
        assert!(Config::from_toml("[replay]\nbatsch = 3").is_err());
        assert!(Config::preset("slow").is_err());
    }
}
