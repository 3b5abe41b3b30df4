//! What allocates in a deployed team: a rule of the environment, or the network of a bundle.

use clap::Args;
use sortie_bundle::Bundle;
use sortie_core::allocate::{
    PlanTeamValue, PointingMemory, ProposalAllocator, TeamQuery, TeamValueNetwork,
};
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile};
use sortie_core::{AllocateError, Allocator};
use sortie_ipc::Draws;
use sortie_learn::subtasks::PROPOSALS;
use sortie_plans::{BundlePlans, CompileError, CompilerProcess, GraphEngine};
use sortie_stage::{Search, SearchSizes, TeamValuePlan};

use crate::ahead::LookingAheadMemory;
use crate::allocation::AllocatorChoice;
use crate::environment::{check_relations, entry_of};
use crate::failure::{Exit, Failure, Outcome};
use crate::policy::Backend;
use crate::tools::{compiler, engines, plans};
use crate::worlds::{RuleAllocator, rule_allocator};

/// The memory of a team's allocator.
pub enum DeployedAllocator {
    Rule(RuleAllocator),
    Learned(Box<LearnedAllocator>),
    Proposing(Box<ProposalMemory>),
    Pointing(Box<PointingMemory>),
    Ahead(Box<LookingAheadMemory>),
}

impl DeployedAllocator {
    /// As [`open`](Self::open), where anybody allocates.
    pub fn open_for(
        bundle: &Bundle,
        choice: Option<AllocatorChoice>,
        backend: Backend,
        (seed, proposals): (u64, ProposalArguments),
    ) -> Result<Option<Self>, Failure> {
        match choice {
            Some(choice) => Self::open(bundle, choice, backend, seed, proposals).map(Some),
            None => proposals.check_unused().map(|()| None),
        }
    }

    /// `seed` matters to what draws, `backend` to the learned allocator, `proposals` to one that proposes.
    pub fn open(
        bundle: &Bundle,
        choice: AllocatorChoice,
        backend: Backend,
        seed: u64,
        proposals: ProposalArguments,
    ) -> Result<Self, Failure> {
        if let Some(rule) = choice.rule() {
            proposals.check_unused()?;
            return Ok(Self::Rule(rule_allocator(entry_of(bundle)?, rule, seed)?));
        }
        if bundle.pointing_graphs().is_some() {
            let memory = open_pointing(bundle, backend)?;
            return match proposals.asked() {
                None | Some(1) => Ok(Self::Pointing(Box::new(memory))),
                Some(turns) => {
                    Ok(Self::Ahead(Box::new(LookingAheadMemory::open(bundle, memory, turns)?)))
                }
            };
        }
        match ProposalMemory::open(bundle, backend, proposals.count(), seed)? {
            Some(memory) => Ok(Self::Proposing(Box::new(memory))),
            None => {
                proposals.check_unused()?;
                Ok(Self::Learned(Box::new(LearnedAllocator::open(bundle, backend)?)))
            }
        }
    }

    /// The allocator over this memory.
    pub fn allocator(&mut self) -> Result<Box<dyn Allocator + Send + '_>, Failure> {
        match self {
            Self::Rule(rule) => Ok(Box::new(rule)),
            Self::Learned(learned) => Ok(Box::new(learned.allocator()?)),
            Self::Proposing(memory) => Ok(Box::new(memory.allocator()?)),
            Self::Pointing(memory) => Ok(Box::new(memory.bind().map_err(CompileError::from)?)),
            Self::Ahead(memory) => Ok(Box::new(memory.bind()?)),
        }
    }
}

/// A bundle's learned allocator: its network and the memory of the search.
pub struct LearnedAllocator {
    network: NetworkMemory,
    search: Search,
}

impl LearnedAllocator {
    /// The plan of the bundle's team-value network, which has given its golden answers, or its graph.
    pub fn open(bundle: &Bundle, backend: Backend) -> Result<Self, Failure> {
        match backend {
            Backend::Plan => Self::of_plan(bundle, &plans(), Profile::Exact),
            Backend::Tract => Self::of_graph(bundle, engines()?.tract()),
        }
    }

    /// The plan of this profile that `plans` gives.
    pub fn of_plan(
        bundle: &Bundle,
        plans: &BundlePlans<CompilerProcess>,
        profile: Profile,
    ) -> Result<Self, Failure> {
        Self::with(bundle, |_| NetworkMemory::of_plan(bundle, plans, profile))
    }

    /// The graph in an engine, once another process has read and run it.
    pub fn of_graph(bundle: &Bundle, engine: &dyn GraphEngine) -> Result<Self, Failure> {
        Self::with(bundle, |onnx| {
            compiler().rehearse(onnx, bundle.manifest().limits.n_max.into(), None)?;
            Ok(NetworkMemory::Graph(engine.team_value(onnx)?))
        })
    }

    fn with(
        bundle: &Bundle,
        network: impl FnOnce(&[u8]) -> Result<NetworkMemory, CompileError>,
    ) -> Result<Self, Failure> {
        let name = bundle.folder().display();
        let onnx = bundle.allocator_onnx().ok_or_else(|| none_learned(&name.to_string()))?;
        check_relations(bundle)?;
        let network = network(onnx).map_err(|error| Failure::from(error).within(&name))?;
        let limits = bundle.manifest().limits;
        let sizes = SearchSizes {
            entities: limits.n_max.into(),
            tasks: limits.t_max.into(),
            team_max: limits.team_max.into(),
        };
        let search = Search::new(entry_of(bundle)?, sizes);
        Ok(Self { network, search: search.ok_or_else(|| none_learned(&name.to_string()))? })
    }

    /// The team-value network alone.
    pub fn network(&mut self) -> Result<impl TeamValueNetwork + Send + '_, Failure> {
        self.network.bind()
    }

    /// Network and search.
    pub fn allocator(&mut self) -> Result<impl Allocator + Send + '_, Failure> {
        Ok(self.search.allocator(self.network.bind()?))
    }
}

/// No learned allocator where one was asked for.
pub fn none_learned(name: &str) -> Failure {
    let message = format!(
        "`{name}` has no learned allocator; choose a rule with --allocation, or a team that learned one"
    );
    Failure::new(Exit::Usage, message)
}

enum NetworkMemory {
    Plan(TeamValuePlan),
    Graph(Box<dyn TeamValueNetwork + Send>),
}

enum BoundNetwork<'a> {
    Plan(Box<PlanTeamValue<'a>>),
    Graph(&'a mut (dyn TeamValueNetwork + Send)),
}

impl NetworkMemory {
    fn of_plan(
        bundle: &Bundle,
        plans: &BundlePlans<CompilerProcess>,
        profile: Profile,
    ) -> Result<Self, CompileError> {
        let plan = plans.allocator(bundle, profile)?.ok_or(PlanError::WrongNetwork)?;
        let entities = usize::from(bundle.manifest().limits.n_max);
        Ok(Self::Plan(TeamValuePlan::new(plan, entities)?))
    }

    fn bind(&mut self) -> Result<BoundNetwork<'_>, Failure> {
        match self {
            Self::Plan(memory) => {
                let network = memory.bind().map_err(CompileError::from)?;
                Ok(BoundNetwork::Plan(Box::new(network)))
            }
            Self::Graph(network) => Ok(BoundNetwork::Graph(network.as_mut())),
        }
    }
}

impl TeamValueNetwork for BoundNetwork<'_> {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        match self {
            Self::Plan(network) => network.value(query),
            Self::Graph(network) => network.value(query),
        }
    }

    fn values(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        match self {
            Self::Plan(network) => network.values(query, teams, values),
            Self::Graph(network) => network.values(query, teams, values),
        }
    }
}

/// The plans of an allocator that points, which have given its golden allocations.
fn open_pointing(bundle: &Bundle, backend: Backend) -> Result<PointingMemory, Failure> {
    refuse_tract(bundle, backend)?;
    let name = bundle.folder().display();
    let found =
        plans().pointing(bundle).and_then(|memory| Ok(memory.ok_or(PlanError::WrongNetwork)?));
    found.map_err(|error| Failure::from(error).within(&name))
}

/// Refuses another engine than plans.
fn refuse_tract(bundle: &Bundle, backend: Backend) -> Outcome {
    if backend == Backend::Plan {
        return Ok(());
    }
    let name = bundle.folder().display();
    let message = format!("the allocator of `{name}` runs as a plan only: `--backend plan`");
    Err(Failure::new(Exit::Usage, message))
}

/// How many allocations are proposed.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct ProposalArguments {
    /// Allocations that a proposing allocator draws, of which the critic takes the best; 1: the most probable one
    /// [default: 32]. One that points plays an episode to its end under as many symmetries, eight at most, and goes by the
    /// best [default: 1]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u16).range(1..=256))]
    proposals: Option<u16>,
}

impl ProposalArguments {
    /// Those of a team whose domain says this.
    pub(crate) fn of(draws: &Draws) -> Self {
        Self { proposals: draws.proposals }
    }

    /// What a domain says of a team that draws with this seed.
    pub(crate) fn draws(self, seed: u64) -> Draws {
        Draws::new(seed, self.proposals)
    }

    /// As many as were asked for, if any.
    pub fn asked(self) -> Option<usize> {
        self.proposals.map(usize::from)
    }

    /// As many as were asked for, else as many as the dissertation's.
    pub fn count(self) -> usize {
        self.asked().unwrap_or(PROPOSALS)
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
        refuse_tract(bundle, backend)?;
        let name = bundle.folder().display();
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
    pub fn allocator(&mut self) -> Result<impl Allocator + Send + '_, Failure> {
        let Self { plan, arena, proposals, seed } = self;
        let bound = Plan::load(plan.as_slice())
            .and_then(|plan| ProposalAllocator::new(plan, arena.as_mut_slice(), *proposals, *seed));
        Ok(bound.map_err(CompileError::from)?)
    }
}
