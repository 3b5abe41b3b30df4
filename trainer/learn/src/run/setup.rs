//! How a run of any method is set up: one readable file.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use sortie_envs::Environment;
use sortie_envs::registry::Setting;
use toml::{Table, Value};

use super::RunConfig;
use crate::configuration::{self, RUN as RUN_SECTION, WHERE};
use crate::error::LearnError;

/// Where a run learns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentChoice {
    /// Name of the environment.
    pub name: String,
    /// Set of starts; empty for the environment's default.
    #[serde(default)]
    pub set: String,
    /// Episodes that run at the same time; one that ends restarts at once.
    pub instances: usize,
    /// Numbers of the rules that differ from the usual ones.
    #[serde(default)]
    pub settings: BTreeMap<String, Setting>,
}

impl EnvironmentChoice {
    /// An environment that is handed over, not found by its name.
    pub fn of(environment: &dyn Environment, instances: usize) -> Self {
        let name = environment.spec().name.to_owned();
        Self { name, instances, ..Self::default() }
    }
}

/// `NAME` or `NAME/SET`.
impl fmt::Display for EnvironmentChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)?;
        if self.set.is_empty() { Ok(()) } else { write!(f, "/{}", self.set) }
    }
}

/// How a run of any method is set up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Setup {
    /// The method's name.
    pub method: String,
    /// Where it learns.
    pub environment: EnvironmentChoice,
    /// How long it learns, and when it measures and saves.
    pub run: RunConfig,
    /// The method's own configuration.
    pub own: Table,
}

const ENVIRONMENT: &str = "environment";
const RUN: &str = "run";
/// What the settings of an environment were called in files of before, and what they are called.
const RENAMED: [&str; 2] = ["constants", "settings"];

impl Setup {
    /// A preset of a method: so many instances, the usual settings of whatever environment.
    ///
    /// # Panics
    /// The method's own configuration is nothing that a file can hold.
    pub fn of(instances: usize, run: RunConfig, own: &impl Serialize) -> Self {
        Self {
            method: String::new(),
            environment: EnvironmentChoice { instances, ..EnvironmentChoice::default() },
            run,
            own: configuration::table_of(own).expect("a configuration is values of a file"),
        }
    }

    /// The method's own configuration as its type.
    ///
    /// # Errors
    /// A key is unknown or has an impossible value.
    pub fn own<T: serde::de::DeserializeOwned>(&self) -> Result<T, LearnError> {
        let own = self.own.clone();
        own.try_into().map_err(|error: toml::de::Error| LearnError::Config(error.message().into()))
    }

    /// Everything but the method's name, as the file has it.
    ///
    /// # Errors
    /// A value cannot be written in TOML.
    pub fn table(&self) -> Result<Table, LearnError> {
        let mut table = self.own.clone();
        table.extend(self.common()?);
        Ok(table)
    }

    /// What the setup of every method has.
    fn common(&self) -> Result<Table, LearnError> {
        let environment = configuration::table_of(&self.environment)?;
        let run = configuration::table_of(&self.run)?;
        Ok([(ENVIRONMENT, environment), (RUN, run)]
            .map(|(name, part)| (name.to_owned(), part.into()))
            .into_iter()
            .collect())
    }

    /// Refuses what no method can learn by.
    ///
    /// # Errors
    /// A value about the environment or the run is outside the limits of its key.
    pub fn check(&self) -> Result<(), LearnError> {
        configuration::check_table("", &self.common()?, &[&WHERE[..], &[RUN_SECTION]].concat())
    }

    /// Everything but the method's name as a file that a person can read.
    ///
    /// # Errors
    /// The method's own configuration is nothing that a file can hold.
    pub fn to_toml(&self) -> Result<String, LearnError> {
        configuration::to_toml(&self.table()?)
    }

    /// Reads the file of a method.
    ///
    /// # Errors
    /// It is no TOML, or lacks what every method has, or that is outside its limits.
    pub fn from_text(method: &str, text: &str) -> Result<Self, LearnError> {
        Self::from_table(method, configuration::parsed(text)?)
    }

    /// Reads a file's table.
    pub(crate) fn from_table(method: &str, mut table: Table) -> Result<Self, LearnError> {
        rename_older(&mut table);
        let bad = |error: toml::de::Error| LearnError::Config(error.message().to_owned());
        let mut take = |name: &str| {
            let missing = || LearnError::Config(format!("there is no section `{name}`"));
            table.remove(name).ok_or_else(missing)
        };
        let (environment, run) = (take(ENVIRONMENT)?, take(RUN)?);
        let setup = Self {
            method: method.to_owned(),
            environment: environment.try_into().map_err(bad)?,
            run: run.try_into().map_err(bad)?,
            own: table,
        };
        setup.check()?;
        Ok(setup)
    }
}

/// Gives what stands in a file under a name of before its name.
pub(crate) fn rename_older(table: &mut Table) {
    let Some(Value::Table(environment)) = table.get_mut(ENVIRONMENT) else { return };
    let [before, now] = RENAMED;
    if !environment.contains_key(now)
        && let Some(settings) = environment.remove(before)
    {
        environment.insert(now.to_owned(), settings);
    }
}

/// An assignment to a key under the name that it has now.
pub(crate) fn renamed(assignment: &str) -> String {
    let [before, now] = RENAMED.map(|name| format!("{ENVIRONMENT}.{name}."));
    match assignment.trim_start().strip_prefix(&before) {
        Some(rest) => now + rest,
        None => assignment.to_owned(),
    }
}
