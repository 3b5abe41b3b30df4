//! The configuration of any run.

use toml::Table;

use super::RunConfig;
use super::description::Configuration;
use crate::configuration;
use crate::error::LearnError;
use crate::methods::alma::Conditioning;
use crate::methods::alma::config::EnvironmentConfig;
use crate::methods::{alma, paper};

/// How a run is configured, by what it learns from.
#[derive(Clone, Debug, PartialEq)]
pub enum Settings {
    /// Records of one step and one subtask: the preset `fast`.
    Records(alma::Config),
    /// Windows of whole episodes: the preset `paper`.
    Windows(paper::Config),
}

impl Settings {
    /// A preset by name: `fast` or `paper`.
    pub fn preset(name: &str) -> Result<Self, LearnError> {
        match name {
            "fast" => Ok(Self::Records(alma::Config::default())),
            "paper" => Ok(Self::Windows(paper::Config::default())),
            _ => Err(LearnError::Config(format!("no preset `{name}`; there are `fast`, `paper`"))),
        }
    }

    /// Reads a configuration; what is missing keeps its default.
    ///
    /// A run's `train.toml` will do: its lines about the run itself are passed over.
    pub fn from_toml(text: &str) -> Result<Self, LearnError> {
        if is_windows(&configuration::parsed(text)?) {
            Ok(Self::Windows(paper::Config::from_toml(text)?))
        } else {
            Ok(Self::Records(alma::Config::from_toml(text)?))
        }
    }

    /// Replaces one value, named as in `run.steps=100_000`.
    pub fn set(&mut self, assignment: &str) -> Result<(), LearnError> {
        match self {
            Self::Records(config) => config.set(assignment),
            Self::Windows(config) => config.set(assignment),
        }
    }

    /// Has a run of the preset `fast` that is shorter than the preset's explore and hand over to its
    /// allocator sooner, in proportion. What `is_given` says stays as it is.
    pub fn fit_to_length(&mut self, is_given: impl Fn(&str) -> bool) {
        if let Self::Records(config) = self {
            config.fit_to_length(is_given);
        }
    }

    /// The configuration as a file that explains every key.
    pub fn explained(&self) -> Result<String, LearnError> {
        match self {
            Self::Records(config) => config.explained(),
            Self::Windows(config) => config.explained(),
        }
    }

    /// The world that is learned in.
    pub fn environment(&self) -> &EnvironmentConfig {
        match self {
            Self::Records(config) => &config.environment,
            Self::Windows(config) => &config.environment,
        }
    }

    /// The same, to be changed.
    pub fn environment_mut(&mut self) -> &mut EnvironmentConfig {
        match self {
            Self::Records(config) => &mut config.environment,
            Self::Windows(config) => &mut config.environment,
        }
    }

    /// What the agents see of the subtasks.
    pub fn subtask(&self) -> Conditioning {
        match self {
            Self::Records(config) => config.network.subtask,
            Self::Windows(config) => config.low_level.conditioning,
        }
    }

    /// The same, to be changed.
    pub fn subtask_mut(&mut self) -> &mut Conditioning {
        match self {
            Self::Records(config) => &mut config.network.subtask,
            Self::Windows(config) => &mut config.low_level.conditioning,
        }
    }

    /// Steps between decisions, unless the open tasks change.
    pub fn interval(&self) -> u32 {
        match self {
            Self::Records(config) => config.allocation.interval,
            Self::Windows(config) => config.allocation.interval,
        }
    }
}

impl Configuration for Settings {
    fn method(&self) -> &str {
        match self {
            Self::Records(config) => config.method(),
            Self::Windows(config) => config.method(),
        }
    }

    fn to_toml(&self) -> Result<String, LearnError> {
        match self {
            Self::Records(config) => config.to_toml(),
            Self::Windows(config) => config.to_toml(),
        }
    }

    fn run(&self) -> &RunConfig {
        match self {
            Self::Records(config) => &config.run,
            Self::Windows(config) => &config.run,
        }
    }

    fn run_mut(&mut self) -> &mut RunConfig {
        match self {
            Self::Records(config) => &mut config.run,
            Self::Windows(config) => &mut config.run,
        }
    }

    fn check(&self) -> Result<(), LearnError> {
        match self {
            Self::Records(config) => config.check(),
            Self::Windows(config) => config.check(),
        }
    }

    fn from_table(method: &str, table: Table) -> Result<Self, LearnError> {
        if is_windows(&table) {
            Ok(Self::Windows(paper::Config::from_table(method, table)?))
        } else {
            Ok(Self::Records(alma::Config::from_table(method, table)?))
        }
    }
}

/// Whether a file is about learning from windows; files about records do not say so.
fn is_windows(table: &Table) -> bool {
    table.get("learner").and_then(toml::Value::as_str) == Some("windows")
}
