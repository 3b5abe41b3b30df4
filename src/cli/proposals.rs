//! The allocator of a bundle that proposes allocations and values them.

use clap::Args;
use sortie_bundle::Bundle;
use sortie_core::Allocator;
use sortie_core::allocate::ProposalAllocator;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile};
use sortie_plans::CompileError;

use crate::compiler::plans;
use crate::failure::{Exit, Failure, Outcome};
use crate::policy::Backend;

/// How many allocations are proposed.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct ProposalArguments {
    /// Allocations that a proposing allocator draws, of which the critic takes the best; 1: the most probable one
    /// [default: 32]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u16).range(1..=256))]
    proposals: Option<u16>,
}

impl ProposalArguments {
    /// As many as were asked for, else as many as the dissertation's.
    pub fn count(self) -> usize {
        self.proposals.unwrap_or(32).into()
    }

    /// As a flag for another process.
    pub fn flag(self) -> Option<String> {
        self.proposals.map(|proposals| format!("--proposals={proposals}"))
    }

    /// Refuses a number that was asked for where nobody proposes.
    pub fn check_unused(self) -> Outcome {
        match self.proposals {
            None => Ok(()),
            Some(_) => {
                let message = "`--proposals` is for an allocator that proposes; this one does not";
                Err(Failure::new(Exit::Usage, message))
            }
        }
    }
}

/// The memory of a bundle's proposing allocator.
pub struct ProposalMemory {
    plan: AlignedBytes,
    arena: AlignedBytes,
    proposals: usize,
    seed: u64,
}

impl ProposalMemory {
    /// Compiles the bundle's networks, or takes the plan that was compiled before; none where its allocator is of
    /// another kind. The seed is that of the draws.
    pub fn open(
        bundle: &Bundle,
        backend: Backend,
        proposals: usize,
        seed: u64,
    ) -> Result<Option<Self>, Failure> {
        Self::open_as(bundle, Profile::Exact, backend, (proposals, seed))
    }

    /// As [`Self::open`] in any profile.
    pub fn open_as(
        bundle: &Bundle,
        profile: Profile,
        backend: Backend,
        (proposals, seed): (usize, u64),
    ) -> Result<Option<Self>, Failure> {
        if bundle.proposal_graphs().is_none() {
            return Ok(None);
        }
        let name = bundle.folder().display();
        if backend == Backend::Tract {
            let message =
                format!("the allocator of `{name}` runs as a plan only: `--backend plan`");
            return Err(Failure::new(Exit::Usage, message));
        }
        let open = || -> Result<Self, CompileError> {
            let plan = plans().proposals(bundle, profile)?;
            let plan = plan.ok_or(PlanError::WrongNetwork)?;
            let loaded = Plan::load(plan.as_slice())?;
            let arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&loaded, proposals));
            Ok(Self { plan, arena, proposals, seed })
        };
        open().map(Some).map_err(|error| Failure::from(error).within(&name))
    }

    /// The allocator over this memory.
    pub fn allocator(&mut self) -> Result<impl Allocator + '_, Failure> {
        let Self { plan, arena, proposals, seed } = self;
        let bound = Plan::load(plan.as_slice())
            .and_then(|plan| ProposalAllocator::new(plan, arena.as_mut_slice(), *proposals, *seed));
        Ok(bound.map_err(CompileError::from)?)
    }
}
