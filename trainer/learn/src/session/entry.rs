//! What a method says of itself to be found by its name.

use sortie_envs::{Environment, Spec};
use toml::Table;

use crate::configuration::{self, RUN, RUN_KEYS, Section, WHERE, find};
use crate::error::{LearnError, Result};
use crate::method::Method;
use crate::run::{Setup, rename_older, renamed};

/// The key that tells setups of a method from each other whose other keys are different ones.
const LEARNER: &str = "learner";

/// One method by its name.
#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    /// Its name, as `sortie train` takes it.
    pub name: &'static str,
    /// What it is, in one sentence.
    pub about: &'static str,
    /// Its own keys; where it has several learners, those that the table's `learner` has.
    pub keys: fn(&Table) -> &'static [Section],
    /// The setups that it comes with by their names, the default first; which environment is up to who asks.
    pub presets: &'static [Preset],
    /// What flags of the command line stand for.
    pub flags: &'static [Flag],
    /// The method that it is compared with: where nobody says where to learn, it learns where that one can.
    pub compared_with: Option<&'static MethodEntry>,
    /// Numbers of steps that a run shorter than the default preset's has shorter in proportion, unless they were given.
    pub in_proportion: &'static [&'static str],
    /// Fits a preset of this name to an environment that asks for other values.
    pub suit: fn(&str, &mut Setup, &Spec),
    /// Gives the file of a run what it learned by before that was a key.
    pub settle_older: fn(&mut Table),
    /// Why it cannot learn in an environment.
    pub misfit: fn(&Spec) -> Option<&'static str>,
    /// Makes one, as it is before its first step, from a setup that was checked, for an environment that fits.
    pub open: fn(&Opening<'_>) -> Result<Box<dyn Method>>,
}

/// A setup that a method comes with.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// Makes it.
    pub setup: fn() -> Setup,
}

/// What a flag of the command line stands for.
#[derive(Clone, Copy, Debug)]
pub struct Flag {
    /// Its name, as in `--mixer`.
    pub name: &'static str,
    /// Values of keys, with `{}` where the flag's own value goes. Of several of one name those count whose keys there are.
    pub assignments: &'static [&'static str],
}

/// What a method is made for.
#[derive(Clone, Copy)]
pub struct Opening<'a> {
    /// How the run is set up.
    pub setup: &'a Setup,
    /// Where it is to learn.
    pub environment: &'a dyn Environment,
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
    pub fn preset(&self, name: &str) -> Result<Setup> {
        let found = self.presets.iter().find(|preset| preset.name == name);
        let unknown = || {
            let known: Vec<&str> = self.presets.iter().map(|preset| preset.name).collect();
            let (method, known) = (self.name, known.join("`, `"));
            LearnError::Config(format!("`{method}` has no preset `{name}`; there are `{known}`"))
        };
        let setup = (found.ok_or_else(unknown)?.setup)();
        Ok(Setup { method: self.name.to_owned(), ..setup })
    }

    /// Reads a file; what is missing is as the first preset of the same learner has it.
    ///
    /// A run's `train.toml` will do: its lines about the run itself are passed over.
    ///
    /// # Errors
    /// A key is unknown or has a value outside its limits.
    pub fn read(&self, text: &str) -> Result<Setup> {
        let mut table = configuration::parsed(text)?;
        rename_older(&mut table);
        if RUN_KEYS.iter().filter_map(|key| table.remove(*key)).count() == RUN_KEYS.len() {
            (self.settle_older)(&mut table);
        }
        let setups = || self.presets.iter().map(|preset| (preset.setup)());
        let alike = |setup: &Setup| setup.own.get(LEARNER) == table.get(LEARNER);
        let base = setups().find(alike).or_else(|| setups().next()).unwrap_or_default();
        configuration::check_file(text, &table, &self.sections(&base.own))?;
        let mut whole = base.table()?;
        configuration::overlay(&mut whole, table);
        Setup::from_table(self.name, whole)
    }

    /// Replaces one value, named as in `run.steps=100_000`.
    ///
    /// # Errors
    /// The key is unknown or the value outside its limits.
    pub fn set(&self, setup: &Setup, assignment: &str) -> Result<Setup> {
        let sections = self.sections(&setup.own);
        let table = configuration::assigned(&sections, setup.table()?, &renamed(assignment))?;
        Setup::from_table(self.name, table)
    }

    /// Replaces what a flag of the command line stands for.
    ///
    /// # Errors
    /// The setup has no such keys, or the value is outside the limits of one.
    pub fn set_flag(&self, setup: &Setup, name: &str, value: &str) -> Result<Setup> {
        let sections = self.sections(&setup.own);
        let stands = |flag: &&Flag| {
            let mut keys =
                flag.assignments.iter().filter_map(|assignment| assignment.split_once('='));
            let is_there =
                |(key, _): (&str, _)| find(&sections, &key.replace("{}", value)).is_some();
            flag.name == name && keys.all(is_there)
        };
        let flag = self.flags.iter().find(stands).ok_or_else(|| {
            let method = self.name;
            let reason = format!("this `{method}` has no key that `{name}` sets: drop `{name}`");
            LearnError::Config(reason)
        })?;
        let set = |setup, assignment: &&str| self.set(&setup, &assignment.replace("{}", value));
        flag.assignments.iter().try_fold(setup.clone(), set)
    }

    /// Shortens what goes by steps in a run that is shorter than that of the default preset. What `is_given` says stays
    /// as it is.
    pub fn fit_to_length(&self, setup: &mut Setup, is_given: impl Fn(&str) -> bool) {
        let whole = self.presets.first().map_or(0, |preset| (preset.setup)().run.steps);
        let steps = setup.run.steps;
        for path in self.in_proportion.iter().filter(|path| steps < whole && !is_given(path)) {
            let mut names = path.split('.');
            let key = names.next().and_then(|first| setup.own.get_mut(first));
            let key = names.try_fold(key, |inner, name| Some(inner?.get_mut(name))).flatten();
            if let Some(toml::Value::Integer(part)) = key {
                *part = (i128::from(*part) * i128::from(steps) / i128::from(whole)) as i64;
            }
        }
    }

    /// Refuses a setup with a value outside the limits of its key, such as that of a file that somebody changed.
    pub fn check(&self, setup: &Setup) -> Result<()> {
        configuration::check_table("", &setup.table()?, &self.sections(&setup.own))
    }

    /// Makes one, as it is before its first step.
    ///
    /// # Errors
    /// The setup has an impossible value, or it cannot learn in such an environment.
    pub fn method(&self, opening: &Opening<'_>) -> Result<Box<dyn Method>> {
        self.check(opening.setup)?;
        let spec = opening.environment.spec();
        match (self.misfit)(spec) {
            None => (self.open)(opening),
            Some(why) => {
                let (method, environment) = (self.name, &spec.name);
                Err(LearnError::Misfit(format!("`{method}` does not fit `{environment}`: {why}")))
            }
        }
    }

    /// A setup as a file that explains every key.
    ///
    /// # Errors
    /// The setup lacks a key.
    pub fn explained(&self, setup: &Setup) -> Result<String> {
        configuration::explained(&self.sections(&setup.own), &setup.table()?)
    }

    /// All keys of a setup whose own table is this one, those at the top of a file first.
    pub fn sections(&self, own: &Table) -> Vec<Section> {
        let mut sections = [&WHERE, (self.keys)(own), &[RUN]].concat();
        sections.sort_by_key(|section| !section.name.is_empty());
        sections
    }
}
