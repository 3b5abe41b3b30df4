//! What a verb works on: a bundle, a training run, or the environment's own script.

use std::path::Path;

use sortie_bundle::{Bundle, MANIFEST, SubtaskConditioning, TRAINING};
use sortie_envs::Environment;
use sortie_learn::run::read_description;
use sortie_methods::alma::run::Run;

use crate::deployment::open_bundle;
use crate::environment::ScenarioSetName;
use crate::failure::{Exit, Failure};
use crate::methods::open_environment;
use crate::output::warn_of_refused;

/// What is evaluated.
pub enum Subject {
    /// A bundle, as deployed.
    Bundle(Box<Bundle>),
    /// A training run: its averaged weights.
    Run(Box<Run>),
    /// The environment's hand-written low level.
    Scripted,
}

/// A run of ALMA, and where it learned.
pub fn open_run(folder: &Path) -> Result<(Run, Box<dyn Environment>), Failure> {
    let description = read_description(folder)?;
    let environment = open_environment(&description.config.environment)?;
    let run = Run::open(folder, environment.spec())?;
    warn_of_refused(&run.refused);
    Ok((run, environment))
}

impl Subject {
    /// Finds out what is named so.
    pub fn find(path: &Path) -> Result<Self, Failure> {
        if path == Path::new("scripted") {
            return Ok(Self::Scripted);
        }
        if path.join(MANIFEST).exists() {
            return Ok(Self::Bundle(Box::new(open_bundle(path)?)));
        }
        if path.join(TRAINING).exists() {
            return Ok(Self::Run(Box::new(open_run(path)?.0)));
        }
        let reason = if path.exists() {
            "is neither a bundle nor a training run: it has no `bundle.toml` and no `train.toml`"
        } else {
            "does not exist; name a bundle, a training run, or `scripted`"
        };
        Err(Failure::new(Exit::Missing, format!("`{}` {reason}", path.display())))
    }

    /// Whether its agents look at subtasks; those of `flat` and `copa` do not.
    pub fn has_subtasks(&self) -> bool {
        match self {
            Self::Run(run) => run.config.subtask().has_subtasks(),
            Self::Bundle(bundle) => {
                bundle.contract().subtask_conditioning != SubtaskConditioning::None
            }
            Self::Scripted => true,
        }
    }

    /// Whether it has learned an allocator.
    pub fn has_allocator(&self) -> bool {
        match self {
            Self::Bundle(bundle) => bundle.has_allocator(),
            Self::Run(run) => run.allocator.is_some(),
            Self::Scripted => false,
        }
    }
    /// The scenario set asked for, else its own.
    pub fn scenario_set(&self, asked: Option<&str>) -> Result<ScenarioSetName, Failure> {
        match (asked, self) {
            (Some(name), _) => ScenarioSetName::parse(name),
            (None, Self::Bundle(bundle)) => {
                ScenarioSetName::parse(&bundle.manifest().contract.environment.name)
            }
            (None, Self::Run(run)) => {
                ScenarioSetName::parse(&run.description.config.environment.to_string())
            }
            (None, Self::Scripted) => Ok(ScenarioSetName::default()),
        }
    }
}
