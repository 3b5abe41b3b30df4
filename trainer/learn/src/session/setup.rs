//! How a run of any method is set up: one readable file.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use sortie_envs::Environment;
use sortie_envs::registry::Setting;
use toml::Table;

use crate::configuration;
use crate::error::LearnError;
use crate::run::{Configuration, RunConfig};

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

impl Setup {
    /// The method's own configuration as its type.
    ///
    /// # Errors
    /// A key is unknown or has an impossible value.
    pub fn own<T: serde::de::DeserializeOwned>(&self) -> Result<T, LearnError> {
        let own = self.own.clone();
        own.try_into().map_err(|error: toml::de::Error| LearnError::Config(error.message().into()))
    }

    /// Everything but the method's name, as the file has it.
    pub(crate) fn table(&self) -> Result<Table, LearnError> {
        let mut table = self.own.clone();
        for (name, part) in [
            (ENVIRONMENT, configuration::table_of(&self.environment)?),
            (RUN, configuration::table_of(&self.run)?),
        ] {
            table.insert(name.to_owned(), part.into());
        }
        Ok(table)
    }
}

impl Configuration for Setup {
    fn method(&self) -> &str {
        &self.method
    }

    fn environment(&self) -> String {
        self.environment.to_string()
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
        let instances = self.environment.instances;
        configuration::require(instances > 0, "`environment.instances` is 0")
    }

    fn to_toml(&self) -> Result<String, LearnError> {
        configuration::to_toml(&self.table()?)
    }

    fn from_table(method: &str, mut table: Table) -> Result<Self, LearnError> {
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
