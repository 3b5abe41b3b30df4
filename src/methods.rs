//! Runs of methods that learn in any environment.

use std::path::Path;

use sortie_bundle::{MANIFEST, TRAINING};
use sortie_envs::{ENVIRONMENTS, Environment, Split};
use sortie_learn::run::{RunDescription, method_of, read_description};
use sortie_learn::session::{EnvironmentChoice, MethodEntry, Opening, Parts, Setup, load_weights};
use sortie_learn::{LearnError, Method};

use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::warn_of_refused;

/// What a run of any method has learned.
pub(crate) struct LearnedMethod {
    pub(crate) description: RunDescription<Setup>,
    pub(crate) environment: Box<dyn Environment>,
    pub(crate) method: Box<dyn Method>,
}

impl LearnedMethod {
    /// Opens a folder, if a run of such a method is in it.
    pub(crate) fn find(folder: &Path) -> Result<Option<Self>, Failure> {
        if folder.join(MANIFEST).exists() || !folder.join(TRAINING).exists() {
            return Ok(None);
        }
        let Some(entry) = sortie_methods::find(&method_of(folder)?) else { return Ok(None) };
        let description = read_description::<Setup>(folder)?;
        let (environment, mut method) = open(entry, &description, 1)?;
        warn_of_refused(&load_weights(folder, &mut *method)?);
        Ok(Some(Self { description, environment, method }))
    }

    /// Where it is to be measured: in the environments that are named, else where it learned.
    pub(crate) fn choices(&self, names: &[String]) -> Result<Vec<EnvironmentChoice>, Failure> {
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

    /// An environment to play in, whose rows and actions have to be those that the agents learned with.
    pub(crate) fn open_as(
        &self,
        choice: &EnvironmentChoice,
    ) -> Result<Box<dyn Environment>, Failure> {
        let environment = open_environment(choice)?;
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
pub(crate) fn open(
    entry: &MethodEntry,
    description: &RunDescription<Setup>,
    threads: usize,
) -> Result<Parts, LearnError> {
    let RunDescription { config: setup, seed, .. } = description;
    entry.check(setup)?;
    let environment = open_environment(&setup.environment)?;
    let spec = environment.spec();
    let method = (entry.open)(&Opening { setup, spec, seed: *seed, threads })?;
    Ok((environment, method))
}

/// The environment that is asked for.
pub(crate) fn open_environment(
    choice: &EnvironmentChoice,
) -> Result<Box<dyn Environment>, LearnError> {
    Ok(sortie_envs::open(&choice.to_string(), Split::Train, 1, &choice.settings)?)
}

/// The environments by their names, with their sets: what a person may choose.
pub(crate) fn environment_names() -> String {
    let names: Vec<&str> = ENVIRONMENTS.iter().map(|entry| entry.name).collect();
    names.join(", ")
}

/// Reads `ENV` or `ENV/SET`; without a set it is the environment's first.
pub(crate) fn choose(choice: &mut EnvironmentChoice, name: &str) -> Outcome {
    let name = ScenarioSetName::parse(name)?;
    choice.name = name.entry().name.to_owned();
    choice.set = name.set().to_owned();
    Ok(())
}
