//! `train.toml`: everything that a run depends on.

use sortie_nn::layers::products::Products;
use toml::Table;

use super::Setup;
use crate::configuration;
use crate::error::LearnError;

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
    pub fn to_toml(&self) -> Result<String, LearnError> {
        let Self { version, seed, threads, config } = self;
        let (method, config) = (&config.method, config.to_toml()?);
        Ok(format!(
            "method = \"{method}\"\nversion = \"{version}\"\nseed = {seed}\nthreads = {threads}\n\n{config}"
        ))
    }

    /// Reads the file's text.
    pub fn from_toml(text: &str) -> Result<Self, LearnError> {
        let bad = |what: &str| LearnError::Config(what.to_owned());
        let mut table = configuration::parsed(text)?;
        let mut take = |name: &str| table.remove(name).ok_or_else(|| bad(&format!("no `{name}`")));
        let (method, version) = (take("method")?, take("version")?);
        let (seed, threads) = (take("seed")?, take("threads")?);
        settle_older(&mut table);
        let text = |value: toml::Value| value.as_str().map(str::to_owned);
        let number = |value: toml::Value| value.as_integer().and_then(|n| u64::try_from(n).ok());
        let method = text(method).ok_or_else(|| bad("`method` is not text"))?;
        Ok(Self {
            version: text(version).ok_or_else(|| bad("`version` is not text"))?,
            seed: number(seed).ok_or_else(|| bad("`seed` is not a number"))?,
            threads: number(threads).ok_or_else(|| bad("`threads` is not a number"))? as usize,
            config: Setup::from_table(&method, table)?,
        })
    }
}

/// Runs that do not say how they compute products began when there was one way only.
fn settle_older(table: &mut Table) {
    let run = table.entry("run").or_insert_with(|| Table::new().into());
    if let Some(run) = run.as_table_mut() {
        run.entry("products").or_insert_with(|| Products::usual().to_string().into());
    }
}
