//! Everything that decides how a run learns, in one readable file.

mod agents;
mod allocation;
mod environment;
mod learning;

use serde::{Deserialize, Serialize};

pub use agents::{AgentNetworkConfig, MixerConfig, NetworkConfig, ReturnsConfig};
pub use allocation::{Allocation, AllocationConfig, AllocatorConfig};
pub use environment::EnvironmentConfig;
pub use learning::ReplayConfig;
pub use sortie_learn::configuration::{ExplorationConfig, OptimiserConfig};

use toml::Table;

use crate::alma::configuration::FAST;
use sortie_learn::LearnError;
use sortie_learn::configuration::{self, Kept, Section, require};
use sortie_learn::run::{Configuration, RunConfig};

/// The configuration of a run. Its defaults are the preset `fast`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The world to learn in.
    pub environment: EnvironmentConfig,
    /// Who assigns agents to buildings while learning.
    pub allocation: AllocationConfig,
    /// The agents' network.
    pub network: AgentNetworkConfig,
    /// How the utilities of a team become its value.
    pub mixer: MixerConfig,
    /// How rewards become targets.
    pub returns: ReturnsConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How much the agents try out.
    pub exploration: ExplorationConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
    /// How the allocator learns.
    pub allocator: AllocatorConfig,
    /// How long to learn, and when to measure and save.
    pub run: RunConfig,
}

impl Config {
    /// Reads a configuration; what is missing keeps its default.
    ///
    /// A run's `train.toml` will do: its lines about the run itself are passed over.
    pub fn from_toml(text: &str) -> Result<Self, LearnError> {
        let config: Self = configuration::from_toml(text)?;
        config.check()?;
        Ok(config)
    }

    /// Replaces one value, named as in `replay.batch=256`.
    pub fn set(&mut self, assignment: &str) -> Result<(), LearnError> {
        let changed: Self = configuration::replaced(self, assignment)?;
        changed.check()?;
        *self = changed;
        Ok(())
    }

    /// Has a run that is shorter than the default explore and hand over to its allocator sooner, in
    /// proportion. What `is_given` says stays as it is.
    pub fn fit_to_length(&mut self, is_given: impl Fn(&str) -> bool) {
        let (steps, whole) = (self.run.steps, RunConfig::default().steps);
        if steps >= whole {
            return;
        }
        let parts = [
            ("exploration.steps", &mut self.exploration.steps),
            ("allocator.learns_from", &mut self.allocator.learns_from),
            ("allocator.decides_from", &mut self.allocator.decides_from),
        ];
        for (_, part) in parts.into_iter().filter(|(key, _)| !is_given(key)) {
            *part = (u128::from(*part) * u128::from(steps) / u128::from(whole)) as u64;
        }
    }

    /// Whether the run learns an allocator; without subtasks there is nothing to allocate.
    pub fn learns_allocator(&self) -> bool {
        self.allocation.is_learned() && self.network.subtask.has_subtasks()
    }

    /// Who allocates where the run is measured, by name.
    pub fn measured_allocation(&self) -> &'static str {
        if self.network.subtask.has_subtasks() { self.allocation.measured().name() } else { "none" }
    }

    /// Refuses values outside their limits, and values that do not go together.
    pub fn check(&self) -> Result<(), LearnError> {
        configuration::check_values(self)?;
        self.allocation.check()?;
        self.network.sizes().check("network")?;
        self.mixer.check()?;
        self.replay.check("replay")?;
        self.allocator.network.check("allocator.network")?;
        self.allocator.replay.check("allocator.replay")
    }

    /// The configuration as a file that explains every key.
    pub fn explained(&self) -> Result<String, LearnError> {
        configuration::explained(self)
    }
}

impl Kept for Config {
    const SECTIONS: &'static [Section] = FAST;

    /// Runs that do not say whether embeddings skip the attention began when none did.
    fn settle_older(run: &mut Table) {
        for path in [&["network"][..], &["allocator", "network"]] {
            let section = path.iter().try_fold(&mut *run, |table, name| {
                table.entry(*name).or_insert_with(|| Table::new().into()).as_table_mut()
            });
            if let Some(section) = section {
                section.entry("skip").or_insert(false.into());
            }
        }
    }
}

impl Configuration for Config {
    fn method(&self) -> &str {
        if self.network.subtask.has_subtasks() { "alma" } else { "flat" }
    }

    fn to_toml(&self) -> Result<String, LearnError> {
        configuration::to_toml(self)
    }

    fn environment(&self) -> String {
        self.environment.full_name()
    }

    fn instances(&self) -> usize {
        self.environment.instances
    }

    fn run(&self) -> &RunConfig {
        &self.run
    }

    fn run_mut(&mut self) -> &mut RunConfig {
        &mut self.run
    }

    fn check(&self) -> Result<(), LearnError> {
        Self::check(self)
    }

    fn from_table(_: &str, mut table: Table) -> Result<Self, LearnError> {
        Self::settle_older(&mut table);
        let config: Self = configuration::from_table(table)?;
        config.check()?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::{Conditioning, MixerKind};

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
            "allocator.network.width=32",
            "environment.constants.episode_limit=99",
            "network.subtask=input",
            "mixer.kind=qmix",
        ] {
            config.set(assignment).unwrap_or_else(|error| panic!("{error}"));
        }
        assert_eq!(config.environment.set, "2-8a_2-8b");
        assert_eq!(config.replay.batch, 1024);
        assert_eq!(config.optimiser.learning_rate, 5e-4);
        assert!(!config.replay.symmetries);
        assert_eq!(config.exploration.spread, [0.0, 1.0]);
        assert_eq!(config.environment.constants.episode_limit, 99);
        assert_eq!(config.network.subtask, Conditioning::Input);
        assert_eq!(config.mixer.kind, MixerKind::Qmix);
    }

    #[test]
    fn a_short_run_explores_and_hands_over_in_proportion() {
        let schedule = |steps: u64, given: &str| {
            let mut config = Config::default();
            config.run.steps = steps;
            config.fit_to_length(|key| key == given);
            let allocator = config.allocator;
            [config.exploration.steps, allocator.learns_from, allocator.decides_from]
        };
        assert_eq!(schedule(60_000, ""), [6_000, 12_000, 15_000]);
        assert_eq!(schedule(60_000, "allocator.learns_from"), [6_000, 120_000, 15_000]);
        for steps in [600_000, 1_500_000] {
            assert_eq!(schedule(steps, ""), [60_000, 120_000, 150_000], "as it always was");
        }
    }

    #[test]
    fn wrong_keys_and_values_are_refused_and_change_nothing() {
        let mut config = Config::default();
        for (assignment, part) in [
            ("replay.batch", "key=value"),
            ("network.heads=5", "multiple"),
            ("mixer.heads=5", "`mixer.width`"),
            ("allocation.learned=0", "positive"),
            ("replay.warm_up=2000000", "`replay.capacity`"),
            ("allocator.moved=2", "`allocator.moved`"),
        ] {
            let error = config.set(assignment).unwrap_err().to_string();
            assert!(error.contains(part), "{assignment}: {error}");
        }
        assert_eq!(config, Config::default());
        assert!(Config::from_toml("[replay]\nbatsch = 3").is_err());
    }
}
