//! What a method says of itself to be found by its name.

use sortie_envs::Spec;
use toml::Table;

use super::Setup;
use crate::configuration::{self, RUN, Section, WHERE};
use crate::error::LearnError;
use crate::method::Method;
use crate::run::Configuration;

/// One method by its name.
#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    /// Its name, as `sortie train` takes it.
    pub name: &'static str,
    /// What it is, in one sentence.
    pub about: &'static str,
    /// Its own keys.
    pub sections: &'static [Section],
    /// The setups that it comes with by their names, the default first; which environment is up to who asks.
    pub presets: &'static [Preset],
    /// Makes one, as it is before its first step.
    pub open: fn(&Opening<'_>) -> Result<Box<dyn Method>, LearnError>,
}

/// A setup that a method comes with.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// Makes it.
    pub setup: fn() -> Setup,
}

/// What a method is made for.
#[derive(Clone, Copy, Debug)]
pub struct Opening<'a> {
    /// How the run is set up.
    pub setup: &'a Setup,
    /// What the environment says of itself.
    pub spec: &'a Spec,
    /// Seed of all random choices.
    pub seed: u64,
    /// Threads to compute with; they change no result.
    pub threads: usize,
}

impl MethodEntry {
    /// One of its presets.
    ///
    /// # Errors
    /// It has none of that name.
    pub fn preset(&self, name: &str) -> Result<Setup, LearnError> {
        let found = self.presets.iter().find(|preset| preset.name == name);
        let known: Vec<&str> = self.presets.iter().map(|preset| preset.name).collect();
        let unknown = || {
            let known = known.join("`, `");
            LearnError::Config(format!(
                "`{}` has no preset `{name}`; there are `{known}`",
                self.name
            ))
        };
        let preset = found.ok_or_else(unknown)?;
        Ok(Setup { method: self.name.to_owned(), ..(preset.setup)() })
    }

    /// Reads a file; what is missing is as `setup` has it.
    ///
    /// # Errors
    /// A key is unknown or has a value outside its limits.
    pub fn read(&self, setup: &Setup, text: &str) -> Result<Setup, LearnError> {
        let table = configuration::table_in(text, &self.sections(), |_| {})?;
        let mut whole = setup.table()?;
        configuration::overlay(&mut whole, table);
        self.made_of(whole)
    }

    /// Replaces one value, named as in `run.steps=100_000`.
    ///
    /// # Errors
    /// The key is unknown or the value outside its limits.
    pub fn set(&self, setup: &Setup, assignment: &str) -> Result<Setup, LearnError> {
        self.made_of(configuration::assigned(&self.sections(), setup.table()?, assignment)?)
    }

    fn made_of(&self, table: Table) -> Result<Setup, LearnError> {
        Setup::from_table(self.name, table)
    }

    /// Refuses a setup with a value outside the limits of its key, such as that of a file that somebody changed.
    ///
    /// # Errors
    /// The first such key.
    pub fn check(&self, setup: &Setup) -> Result<(), LearnError> {
        configuration::check_table("", &setup.table()?, &self.sections())
    }

    /// A setup as a file that explains every key.
    ///
    /// # Errors
    /// The setup lacks a key.
    pub fn explained(&self, setup: &Setup) -> Result<String, LearnError> {
        configuration::explained_by(&self.sections(), &setup.table()?)
    }

    /// All keys with their defaults, as a part of a page of documentation.
    ///
    /// # Errors
    /// A preset lacks a key.
    pub fn reference(&self) -> Result<String, LearnError> {
        let mut text = String::new();
        for preset in self.presets {
            let title = format!("`{}`, preset `{}`", self.name, preset.name);
            text += &configuration::tables(&title, &self.sections(), &(preset.setup)().table()?)?;
        }
        Ok(text)
    }

    /// All keys of a setup.
    pub fn sections(&self) -> Vec<Section> {
        [&WHERE, self.sections, &[RUN]].concat()
    }
}
