//! Environments by name, and whether a bundle fits one.

use std::fmt;

use sortie_bundle::{Bundle, Environment};
use sortie_envs::ENVIRONMENTS;
use sortie_envs::save_the_city::{
    ACTION_NAMES, ENTRY, FEATURE_NAMES, SET_NAMES, ScenarioSet, VERSION,
};

use crate::failure::{Exit, Failure};

/// The dissertation's scenario set.
const DEFAULT_SET: &str = "2-5a_2-5b";

/// An environment and one of its scenario sets, written `ENV/SET`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ScenarioSetName {
    environment: String,
    set: String,
}

impl ScenarioSetName {
    /// Reads `ENV` or `ENV/SET`, several sets joined by `+`, and checks that they exist.
    pub(crate) fn parse(text: &str) -> Result<Self, Failure> {
        let (environment, set) = text.split_once('/').unwrap_or((text, DEFAULT_SET));
        let known: Vec<&str> = ENVIRONMENTS.iter().map(|entry| entry.name).collect();
        if !known.contains(&environment) {
            return Err(unknown("environment", environment, &known));
        }
        if environment != ENTRY.name {
            let reason = format!(
                "`{environment}` is no environment that teams are learned and deployed in, only `{}` is; \
                 `sortie bench env --env {environment}` steps it",
                ENTRY.name
            );
            return Err(Failure::new(Exit::Usage, reason));
        }
        if let Some(unknown_set) = set.split('+').find(|name| !SET_NAMES.contains(name)) {
            return Err(unknown("scenario set", unknown_set, &SET_NAMES));
        }
        ScenarioSet::named(set).map_err(|error| Failure::new(Exit::Usage, error.to_string()))?;
        Ok(Self { environment: environment.to_string(), set: set.to_string() })
    }

    /// The scenario set's own name.
    pub(crate) fn set(&self) -> &str {
        &self.set
    }
}

impl fmt::Display for ScenarioSetName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.environment, self.set)
    }
}

/// Whether a bundle's environment is built in, in this version; the reason if not.
pub(crate) fn check_known(environment: &Environment) -> Result<(), String> {
    let Environment { name, version, .. } = environment;
    ScenarioSetName::parse(name).map_err(|failure| failure.message)?;
    if version == VERSION {
        return Ok(());
    }
    Err(format!(
        "it was learned in version {version} of `{name}`, this program has version {VERSION}"
    ))
}

fn unknown(what: &str, name: &str, known: &[&str]) -> Failure {
    let known = known.join(", ");
    Failure::new(Exit::Usage, format!("unknown {what} `{name}`; known: {known}"))
}

/// Refuses a bundle that was trained for other features or actions, or for smaller teams.
pub(crate) fn check_fits(bundle: &Bundle, set: &ScenarioSet) -> Result<(), Failure> {
    let mismatch = |reason: String| {
        Err(Failure::new(Exit::Mismatch, format!("{}: {reason}", bundle.folder().display())))
    };
    let contract = bundle.contract();
    if contract.feature_names != FEATURE_NAMES || contract.action_names != ACTION_NAMES {
        return mismatch("the bundle was trained for other features or actions".to_string());
    }
    let limits = &bundle.manifest().limits;
    let (entities, tasks) = (set.max_agents + set.max_buildings, set.max_buildings);
    if entities > usize::from(limits.n_max) || tasks > usize::from(limits.t_max) {
        return mismatch(format!(
            "`{}` has {entities} entities and {tasks} subtasks, the bundle takes at most {} and {}; \
             choose a smaller set with --env or train on this one",
            set.name, limits.n_max, limits.t_max
        ));
    }
    Ok(())
}
