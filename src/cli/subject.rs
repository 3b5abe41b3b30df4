//! What a verb works on: a bundle, a training run, or the environment's own script.

use std::path::Path;

use sortie_bundle::{Bundle, MANIFEST, SubtaskConditioning, TRAINING};
use sortie_envs::{DecisionPoints, Entry, Environment, Split};
use sortie_learn::subtasks::{self, Allocate, NoSubtasks};

use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::{DeployedAllocator, ProposalArguments, none_learned};
use crate::deployment::open_bundle;
use crate::environment::{ScenarioSetName, check_fits};
use crate::failure::{Exit, Failure};
use crate::methods::{LearnedMethod, choose};
use crate::policy::Backend;

/// What is evaluated.
pub enum Subject {
    /// A bundle, as deployed.
    Bundle(Box<Bundle>),
    /// A training run: its averaged weights, where its method averages.
    Run(Box<LearnedMethod>),
    /// The environment's hand-written low level.
    Scripted,
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
            return Ok(Self::Run(Box::new(LearnedMethod::open(path)?)));
        }
        let reason = if path.exists() {
            "is neither a bundle nor a training run: it has no `bundle.toml` and no `train.toml`"
        } else {
            "does not exist; name a bundle, a training run, or `scripted`"
        };
        Err(Failure::new(Exit::Missing, format!("`{}` {reason}", path.display())))
    }

    /// Whether its agents look at subtasks.
    pub fn has_subtasks(&self) -> bool {
        match self {
            Self::Run(run) => run.method.subtasks().is_some_and(|subtasks| subtasks.are_seen),
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
            Self::Run(run) => run.method.subtasks().is_some_and(|it| it.allocator.is_some()),
            Self::Scripted => false,
        }
    }

    /// Steps between decisions of who allocates its agents.
    pub fn interval(&self) -> u32 {
        let usual = DecisionPoints::ACTION_LENGTH;
        match self {
            Self::Bundle(bundle) => bundle.contract().decision_interval,
            Self::Run(run) => run.method.subtasks().map_or(usual, |subtasks| subtasks.interval),
            Self::Scripted => usual,
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

    /// A scenario set that it fits, opened.
    pub fn open(&self, set: &ScenarioSetName) -> Result<Box<dyn Environment>, Failure> {
        match self {
            Self::Bundle(bundle) => check_fits(bundle, set).and_then(|()| set.open(Split::Test)),
            Self::Run(run) => {
                let mut choice = run.description.config.environment.clone();
                choose(&mut choice, &set.to_string())?;
                run.open_as(&choice)
            }
            Self::Scripted => set.open(Split::Test),
        }
    }
}

/// The memory of an allocator.
pub enum SubjectAllocator<'a> {
    /// Of a team that knows of no subtasks.
    Nobody,
    Rule(Allocation),
    /// A run's, by the method's own pass.
    Run(Box<dyn Allocate + 'a>),
    /// A bundle's, as deployed.
    Bundle(DeployedAllocator),
}

/// Who allocates for a team in an environment, by name, and the memory of it.
///
/// What was asked for, else the learned allocator where `owner` has one, else the coordinated rule; for a team that knows
/// of no subtasks nobody, and asking for an allocator is a mistake.
pub fn open_for<'a>(
    (team, entry): (&Subject, &'static Entry),
    asked: Option<AllocatorChoice>,
    owner: &'a Subject,
    name: &str,
    backend: Backend,
    draws: (ProposalArguments, u64),
) -> Result<(&'static str, SubjectAllocator<'a>), Failure> {
    if team.has_subtasks() {
        let choice = AllocatorChoice::or_default(asked, owner.has_allocator(), entry)?;
        let allocator = SubjectAllocator::open(choice, Some(owner), name, backend, draws)?;
        return Ok((choice.name(), allocator));
    }
    draws.0.check_unused()?;
    match asked {
        None => Ok(("none", SubjectAllocator::Nobody)),
        Some(choice) => Err(choice.of_no_use()),
    }
}

impl<'a> SubjectAllocator<'a> {
    /// What was chosen; a learned allocator is that of `owner`, which is called `name`. Proposals and seed matter to
    /// one that proposes.
    pub fn open(
        choice: AllocatorChoice,
        owner: Option<&'a Subject>,
        name: &str,
        backend: Backend,
        (proposals, seed): (ProposalArguments, u64),
    ) -> Result<Self, Failure> {
        if let Some(rule) = choice.rule() {
            proposals.check_unused()?;
            return Ok(Self::Rule(rule));
        }
        match owner.filter(|owner| owner.has_allocator()) {
            Some(Subject::Bundle(bundle)) => {
                let learned = AllocatorChoice::Learned;
                DeployedAllocator::open(bundle, learned, backend, seed, proposals).map(Self::Bundle)
            }
            Some(Subject::Run(run)) => {
                let learned = run.method.subtasks().and_then(|subtasks| subtasks.allocator);
                let mut allocate = learned.ok_or_else(|| none_learned(name))?.allocate;
                if !allocate.choose_among(proposals.asked(), run.environment.spec()) {
                    proposals.check_unused()?;
                }
                Ok(Self::Run(allocate))
            }
            Some(Subject::Scripted) | None => Err(none_learned(name)),
        }
    }

    /// Whether it is a bundle's.
    pub fn is_deployed(&self) -> bool {
        matches!(self, Self::Bundle(_))
    }

    /// The allocator over this memory.
    pub fn allocator(&mut self) -> Result<Box<dyn Allocate + '_>, Failure> {
        Ok(match self {
            Self::Nobody => Box::new(NoSubtasks),
            Self::Rule(rule) => Box::new(rule.measured()),
            Self::Run(allocate) => Box::new(allocate.as_mut()),
            Self::Bundle(memory) => Box::new(subtasks::DeployedAllocator(memory.allocator()?)),
        })
    }
}
