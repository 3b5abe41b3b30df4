//! Runs of methods that learn in any environment.

use std::collections::BTreeMap;
use std::path::Path;

use sortie_envs::{ENVIRONMENTS, Entry, Environment, Split};
use sortie_learn::run::{RunDescription, method_of, read_description};
use sortie_learn::session::{EnvironmentChoice, MethodEntry, Opening, Parts, Setup, load_weights};
use sortie_learn::{LearnError, Method};
use sortie_methods::METHODS;

use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::warn_of_refused;

/// What a run of any method has learned.
pub struct LearnedMethod {
    pub description: RunDescription,
    pub environment: Box<dyn Environment>,
    pub method: Box<dyn Method>,
}

impl LearnedMethod {
    /// Opens the run in a folder.
    pub fn open(folder: &Path) -> Result<Self, Failure> {
        Self::open_with(folder, |_, setup| setup)
    }

    /// The same under a setup that differs in what is used, not in what was learned.
    pub fn open_with(
        folder: &Path,
        change: impl FnOnce(&MethodEntry, Setup) -> Setup,
    ) -> Result<Self, Failure> {
        let name = method_of(folder)?;
        let unknown = || {
            let known: Vec<&str> = METHODS.iter().map(|entry| entry.name).collect();
            let (folder, known) = (folder.display(), known.join(", "));
            let reason = format!("{folder} learned by `{name}`, which is none of: {known}");
            Failure::new(Exit::BadData, reason)
        };
        let entry = sortie_methods::find(&name).ok_or_else(unknown)?;
        let mut description = read_description(folder)?;
        description.config = change(entry, description.config);
        let (environment, mut method) = open(entry, &description, 1)?;
        warn_of_refused(&load_weights(folder, &mut *method)?);
        Ok(Self { description, environment, method })
    }

    /// Where it is to be measured: in the environments that are named, else where it learned.
    pub fn choices(&self, names: &[String]) -> Result<Vec<EnvironmentChoice>, Failure> {
        let own = &self.description.config.environment;
        if names.is_empty() {
            return Ok(vec![own.clone()]);
        }
        let chosen = |name: &String| {
            let mut choice = own.clone();
            choose(&mut choice, name).map(|()| choice)
        };
        names.iter().map(chosen).collect()
    }

    /// An environment to play in, whose rows and actions have to be those that the agents learned with. Agents with
    /// subtasks play by its usual rules, as their bundle does.
    pub fn open_as(&self, choice: &EnvironmentChoice) -> Result<Box<dyn Environment>, Failure> {
        let mut rules = choice.clone();
        if self.method.subtasks().is_some() {
            rules.settings.clear();
        }
        let environment = open_environment(&rules)?;
        let (known, spec) = (self.environment.spec(), environment.spec());
        if known.features == spec.features && known.actions == spec.actions {
            return Ok(environment);
        }
        let reason = format!(
            "the agents learned in `{}`, with other features or actions than `{choice}` has",
            self.description.config.environment
        );
        Err(Failure::new(Exit::Mismatch, reason))
    }
}

/// Makes environment and method as a run is set up, the method as it is before its first step.
pub fn open(
    entry: &MethodEntry,
    description: &RunDescription,
    threads: usize,
) -> Result<Parts, LearnError> {
    let RunDescription { config: setup, seed, .. } = description;
    let environment = open_environment(&setup.environment)?;
    let opening = Opening { setup, environment: &*environment, seed: *seed, threads };
    let method = entry.method(&opening);
    let method = method.map_err(|error| match error {
        LearnError::Misfit(why) => {
            let fitting =
                METHODS.iter().filter(|other| (other.misfit)(environment.spec()).is_none());
            let fitting: Vec<&str> = fitting.map(|other| other.name).collect();
            LearnError::Misfit(format!("{why}; what fits: {}", fitting.join(", ")))
        }
        error => error,
    })?;
    Ok((environment, method))
}

/// Names the environment where nobody did and only one fits the method, or the one that it is compared with, and its first
/// set where there is none.
pub fn settle(entry: &MethodEntry, choice: &mut EnvironmentChoice) -> Outcome {
    if choice.name.is_empty() {
        let usual = entry.compared_with.unwrap_or(entry);
        let fits = |other: &&Entry| {
            let opened = sortie_envs::open(other.name, Split::Train, 0, &BTreeMap::new());
            opened.is_ok_and(|environment| (usual.misfit)(environment.spec()).is_none())
        };
        let fitting: Vec<&Entry> = ENVIRONMENTS.iter().filter(fits).collect();
        let [only] = fitting[..] else {
            let names: Vec<&str> = fitting.iter().map(|other| other.name).collect();
            let (name, names) = (entry.name, names.join(", "));
            let reason = format!("`{name}` learns anywhere: say where by `--env`: {names}");
            return Err(Failure::new(Exit::Usage, reason));
        };
        only.name.clone_into(&mut choice.name);
    }
    if choice.set.is_empty() {
        let name = choice.name.clone();
        choose(choice, &name)?;
    }
    Ok(())
}

/// Fits a preset to the environment that it is to learn in, if that is known and fits.
pub fn suit(entry: &MethodEntry, preset: &str, setup: &mut Setup) -> Outcome {
    let mut choice = setup.environment.clone();
    settle(entry, &mut choice)?;
    let environment = open_environment(&choice)?;
    (entry.suit)(preset, setup, environment.spec());
    Ok(())
}

/// The environment that is asked for.
pub fn open_environment(choice: &EnvironmentChoice) -> Result<Box<dyn Environment>, LearnError> {
    let worlds = sortie_envs::open(&choice.to_string(), Split::Train, 1, &choice.settings)?;
    Ok(choice.with_failures(worlds))
}

/// Reads `ENV` or `ENV/SET`; without a set it is the environment's first.
pub fn choose(choice: &mut EnvironmentChoice, name: &str) -> Outcome {
    let name = ScenarioSetName::parse(name)?;
    choice.name = name.entry().name.to_owned();
    choice.set = name.set().to_owned();
    Ok(())
}
