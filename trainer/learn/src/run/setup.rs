//! How a run of any method is set up: one readable file, `train.toml`, and what two of them have in common.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use sortie_envs::registry::Setting;
use sortie_envs::{Environment, Failing};
use sortie_nn::layers::products::Products;
use toml::{Table, Value};

use crate::configuration::{self, RUN as RUN_SECTION, RUN_KEYS, RunConfig, WHERE, WIDEST};
use crate::error::{LearnError, Result};

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
    /// How probable it is in a step that an agent fails for the rest of its episode.
    #[serde(default)]
    pub failures: f64,
    /// Numbers of the rules that differ from the usual ones.
    #[serde(default)]
    pub settings: BTreeMap<String, Setting>,
}

impl EnvironmentChoice {
    /// An environment that is handed over, not found by its name.
    pub fn of(environment: &dyn Environment, instances: usize) -> Self {
        let name = environment.spec().name.to_string();
        Self { name, instances, ..Self::default() }
    }

    /// The same environment, in which agents fail where that is wanted.
    pub fn with_failures(&self, environment: Box<dyn Environment>) -> Box<dyn Environment> {
        match self.failures > 0.0 {
            true => Box::new(Failing::new(environment, self.failures)),
            false => environment,
        }
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
    pub fn own<T: serde::de::DeserializeOwned>(&self) -> Result<T> {
        configuration::as_type(self.own.clone().into())
    }

    /// Everything but the method's name, as the file has it.
    pub fn table(&self) -> Result<Table> {
        let mut table = self.own.clone();
        table.extend(self.common()?);
        Ok(table)
    }

    /// What the setup of every method has.
    fn common(&self) -> Result<Table> {
        let environment = configuration::table_of(&self.environment)?;
        let run = configuration::table_of(&self.run)?;
        let parts = [(ENVIRONMENT, environment), (RUN, run)];
        Ok(parts.into_iter().map(|(name, part)| (name.to_owned(), part.into())).collect())
    }

    /// Refuses what no method can learn by.
    ///
    /// # Errors
    /// A value about the environment or the run is outside the limits of its key.
    pub fn check(&self) -> Result<()> {
        configuration::check_table("", &self.common()?, &[&WHERE[..], &[RUN_SECTION]].concat())
    }

    /// Everything but the method's name as a file that a person can read.
    ///
    /// # Errors
    /// The method's own configuration is nothing that a file can hold.
    pub fn to_toml(&self) -> Result<String> {
        configuration::to_toml(&self.table()?)
    }

    /// Reads the file of a method.
    ///
    /// # Errors
    /// It is no TOML, or lacks what every method has, or that is outside its limits.
    pub fn from_text(method: &str, text: &str) -> Result<Self> {
        Self::from_table(method, configuration::parsed(text)?)
    }

    pub(crate) fn from_table(method: &str, mut table: Table) -> Result<Self> {
        rename_older(&mut table);
        let mut take = |name: &str| {
            let missing = || LearnError::Config(format!("there is no section `{name}`"));
            table.remove(name).ok_or_else(missing)
        };
        let (environment, run) = (take(ENVIRONMENT)?, take(RUN)?);
        let setup = Self {
            method: method.to_owned(),
            environment: configuration::as_type(environment)?,
            run: configuration::as_type(run)?,
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

impl RunConfig {
    /// Writes in the place of `widest` what that is on this processor, and refuses what it does not have.
    pub fn settle_products(&mut self) -> Result<()> {
        if self.products == WIDEST {
            self.products = Products::widest().to_string();
        }
        self.settled_products().map(drop)
    }

    /// The products of a run, if this processor has them.
    pub fn settled_products(&self) -> Result<Products> {
        let here = Products::widest();
        match self.products.parse() {
            _ if self.products == WIDEST => Ok(here),
            Ok(products) if Products::are_available(products) => Ok(products),
            _ => {
                Err(LearnError::Products { asked: self.products.clone(), widest: here.to_string() })
            }
        }
    }
}

/// How a run learns. The same description gives the same weights, whatever the number of threads.
#[derive(Clone, Debug, PartialEq)]
pub struct RunDescription {
    /// Version of Sortie that began the run.
    pub version: String,
    /// Seed of all random choices.
    pub seed: u64,
    /// Threads that compute gradients.
    pub threads: usize,
    /// Method, environment and the complete configuration.
    pub config: Setup,
}

impl RunDescription {
    /// A run of this version of Sortie.
    pub fn new(config: Setup, seed: u64, threads: usize) -> Self {
        Self { version: env!("CARGO_PKG_VERSION").to_owned(), seed, threads, config }
    }

    /// The file's text: four lines about the run, then the configuration.
    pub fn to_toml(&self) -> Result<String> {
        let Self { version, seed, threads, config } = self;
        let (method, config) = (&config.method, config.to_toml()?);
        Ok(format!(
            "method = \"{method}\"\nversion = \"{version}\"\nseed = {seed}\nthreads = {threads}\n\n{config}"
        ))
    }

    /// Reads the file's text.
    pub fn from_toml(text: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct About {
            method: String,
            version: String,
            seed: u64,
            threads: usize,
        }
        let mut table = configuration::parsed(text)?;
        let about = RUN_KEYS.iter().filter_map(|key| table.remove_entry(*key));
        let About { method, version, seed, threads } =
            configuration::as_type(Value::Table(about.collect()))?;
        settle_older(&mut table);
        Ok(Self { version, seed, threads, config: Setup::from_table(&method, table)? })
    }
}

/// Runs that do not say how they compute products began when there was one way only.
fn settle_older(table: &mut Table) {
    let run = table.entry("run").or_insert_with(|| Table::new().into());
    if let Some(run) = run.as_table_mut() {
        run.entry("products").or_insert_with(|| Products::usual().to_string().into());
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

impl Difference {
    /// The keys whose values are others in `theirs`: `run.steps` first, on which others may depend, then in the order of
    /// the alphabet.
    pub fn between(ours: &Setup, theirs: &Setup) -> Result<Vec<Self>> {
        let table = |setup: &Setup| configuration::parsed(&setup.to_toml()?);
        Ok(Self::between_tables(&table(ours)?, &table(theirs)?))
    }

    /// The same of what two files say.
    pub fn between_tables(ours: &Table, theirs: &Table) -> Vec<Self> {
        let (ours, theirs) = (by_key(ours), by_key(theirs));
        let mut keys: Vec<&String> = ours.keys().chain(theirs.keys()).collect();
        keys.sort_by_key(|key| (*key != "run.steps", *key));
        keys.dedup();
        let value = |values: &BTreeMap<String, Value>, key: &str| match values.get(key) {
            Some(value) => value.to_string(),
            None => "not there".to_owned(),
        };
        let differ = |key: &&String| ours.get(*key) != theirs.get(*key);
        let difference = |key: &String| Self {
            key: key.clone(),
            ours: value(&ours, key),
            theirs: value(&theirs, key),
        };
        keys.into_iter().filter(differ).map(difference).collect()
    }
}

/// The keys that a file has a value for.
pub fn keys_in(text: &str) -> Result<Vec<String>> {
    Ok(by_key(&configuration::parsed(text)?).into_keys().collect())
}

fn by_key(table: &Table) -> BTreeMap<String, Value> {
    let mut values = BTreeMap::new();
    flatten("", table.clone(), &mut values);
    values
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_widest_gets_its_name_and_what_is_not_there_is_refused() {
        let mut run = RunConfig::default();
        run.settle_products().unwrap();
        assert_eq!(run.products, Products::widest().to_string());
        for products in Products::ALL {
            run.products = products.to_string();
            assert_eq!(run.settle_products().is_ok(), products.are_available());
        }
        run.products = "avx1024".to_owned();
        let error = run.settle_products().unwrap_err().to_string();
        let widest = format!("run.products={}", Products::widest());
        assert!(error.contains("avx1024") && error.contains(&widest), "{error}");
    }
}
