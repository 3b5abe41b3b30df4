//! What allocates in episodes that one process plays: a rule, or what a subject has learned.

use sortie_envs::Entry;
use sortie_methods::alma::run::{Run, RunAllocator};
use sortie_methods::alma::teams::{Allocate, DeployedAllocator, NoSubtasks};

use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::{LearnedAllocator as DeployedLearned, none_learned};
use crate::failure::Failure;
use crate::policy::Backend;
use crate::proposals::{ProposalArguments, ProposalMemory};
use crate::subject::Subject;

/// The memory of an allocator.
pub enum SubjectAllocator<'a> {
    /// Of a team that knows of no subtasks.
    Nobody,
    Rule(Allocation),
    /// A run's, with the trainer's own forward pass.
    Run(&'a Run, ProposalArguments),
    /// A bundle's, as deployed.
    Bundle(Box<DeployedLearned>),
    /// A bundle's that proposes, as deployed.
    Proposing(Box<ProposalMemory>),
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
        let owner = owner.filter(|owner| owner.has_allocator());
        match owner {
            Some(Subject::Bundle(bundle)) => {
                match ProposalMemory::open(bundle, backend, proposals.count(), seed)? {
                    Some(memory) => Ok(Self::Proposing(Box::new(memory))),
                    None => {
                        proposals.check_unused()?;
                        Ok(Self::Bundle(Box::new(DeployedLearned::open(bundle, backend)?)))
                    }
                }
            }
            Some(Subject::Run(run)) => {
                if !matches!(run.allocator, Some(RunAllocator::Proposals { .. })) {
                    proposals.check_unused()?;
                }
                Ok(Self::Run(run, proposals))
            }
            Some(Subject::Scripted) | None => Err(none_learned(name)),
        }
    }

    /// Whether it is a bundle's.
    pub fn is_deployed(&self) -> bool {
        matches!(self, Self::Bundle(_) | Self::Proposing(_))
    }

    /// The allocator over this memory.
    pub fn allocator(&mut self) -> Result<Box<dyn Allocate + '_>, Failure> {
        Ok(match self {
            Self::Nobody => Box::new(NoSubtasks),
            Self::Rule(rule) => Box::new(rule.measured()),
            Self::Run(run, proposals) => {
                run.learned_allocator(proposals.count()).ok_or_else(|| none_learned("the run"))?
            }
            Self::Bundle(learned) => Box::new(DeployedAllocator(Box::new(learned.allocator()?))),
            Self::Proposing(memory) => Box::new(DeployedAllocator(Box::new(memory.allocator()?))),
        })
    }
}
