//! The configuration of any run.

use std::collections::{BTreeMap, BTreeSet};

use toml::{Table, Value};

use super::description::Configuration;
use crate::configuration;
use crate::error::LearnError;
use crate::methods::alma::Conditioning;
use crate::methods::alma::config::{EnvironmentConfig, RunConfig};
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

    /// The keys that a file has a value for.
    pub fn keys_in(text: &str) -> Result<Vec<String>, LearnError> {
        let mut values = BTreeMap::new();
        flatten("", configuration::parsed(text)?, &mut values);
        Ok(values.into_keys().collect())
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

    /// Refuses values that cannot work.
    pub fn check(&self) -> Result<(), LearnError> {
        match self {
            Self::Records(config) => config.check(),
            Self::Windows(config) => config.check(),
        }
    }

    /// The first key whose value is another in `other`: `run.steps`, on which others may depend, then in the
    /// order of the alphabet.
    pub fn difference(&self, other: &Self) -> Result<Option<Difference>, LearnError> {
        let (ours, theirs) = (flat(self)?, flat(other)?);
        let keys: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
        let value = |values: &BTreeMap<String, Value>, key| match values.get(key) {
            Some(value) => value.to_string(),
            None => "not there".to_owned(),
        };
        let steps = "run.steps".to_owned();
        Ok([&steps].into_iter().chain(keys).find(|key| ours.get(*key) != theirs.get(*key)).map(
            |key| Difference {
                key: key.clone(),
                ours: value(&ours, key),
                theirs: value(&theirs, key),
            },
        ))
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

    /// How long it learns, and when it measures and saves.
    pub fn run(&self) -> &RunConfig {
        match self {
            Self::Records(config) => &config.run,
            Self::Windows(config) => &config.run,
        }
    }

    /// The same, to be changed.
    pub fn run_mut(&mut self) -> &mut RunConfig {
        match self {
            Self::Records(config) => &mut config.run,
            Self::Windows(config) => &mut config.run,
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
    fn method(&self) -> &'static str {
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

    fn from_table(table: Table) -> Result<Self, LearnError> {
        if is_windows(&table) {
            Ok(Self::Windows(paper::Config::from_table(table)?))
        } else {
            Ok(Self::Records(alma::Config::from_table(table)?))
        }
    }
}

/// A key that two configurations have other values for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The key, as in `run.steps`.
    pub key: String,
    /// Its value in the one.
    pub ours: String,
    /// Its value in the other.
    pub theirs: String,
}

/// All values of a configuration by their keys.
fn flat(settings: &Settings) -> Result<BTreeMap<String, Value>, LearnError> {
    let table: Table = settings
        .to_toml()?
        .parse()
        .map_err(|error: toml::de::Error| LearnError::Config(error.message().to_owned()))?;
    let mut values = BTreeMap::new();
    flatten("", table, &mut values);
    Ok(values)
}

fn flatten(name: &str, table: Table, to: &mut BTreeMap<String, Value>) {
    for (key, value) in table {
        let key = if name.is_empty() { key } else { format!("{name}.{key}") };
        match value {
            Value::Table(inner) => flatten(&key, inner, to),
            value => drop(to.insert(key, value)),
        }
    }
}

/// Whether a file is about learning from windows; files about records do not say so.
fn is_windows(table: &Table) -> bool {
    table.get("learner").and_then(toml::Value::as_str) == Some("windows")
}
