//! What allocates in a deployed team: a rule of the environment, or the network of a bundle.

use sortie_bundle::Bundle;
use sortie_core::allocate::{
    EXACT_AGENTS, PlanTeamValue, SearchMemory, TaskRelation, TeamQuery, TeamValueAllocator,
    TeamValueNetwork, exact,
};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{AllocateError, Allocator};
use sortie_envs::Entry;
use sortie_plans::{BundlePlans, CompileError, CompilerProcess, GraphEngine};

use crate::allocation::{Allocation, AllocatorChoice, usual_rule};
use crate::compiler::{compiler, plans};
use crate::engines::engines;
use crate::environment::entry_of;
use crate::failure::{Exit, Failure};
use crate::policy::Backend;
use crate::proposals::{ProposalArguments, ProposalMemory};
use crate::worlds::rules::{FrameRelation, RuleAllocator};

/// The memory of a team's allocator.
pub(crate) enum DeployedAllocator {
    Rule(RuleAllocator),
    Learned(Box<LearnedAllocator>),
    Proposing(Box<ProposalMemory>),
}

impl DeployedAllocator {
    /// As [`open`](Self::open), where anybody allocates.
    pub(crate) fn open_for(
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
    pub(crate) fn open(
        bundle: &Bundle,
        choice: AllocatorChoice,
        backend: Backend,
        seed: u64,
        proposals: ProposalArguments,
    ) -> Result<Self, Failure> {
        if let Some(rule) = choice.rule() {
            proposals.check_unused()?;
            return Ok(Self::Rule(RuleAllocator::new(entry_of(bundle)?, rule, seed)?));
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
    pub(crate) fn allocator(&mut self) -> Result<Box<dyn Allocator + '_>, Failure> {
        match self {
            Self::Rule(rule) => Ok(Box::new(rule)),
            Self::Learned(learned) => Ok(Box::new(learned.allocator()?)),
            Self::Proposing(memory) => Ok(Box::new(memory.allocator()?)),
        }
    }
}

/// A bundle's learned allocator: its network and the memory of the search.
pub(crate) struct LearnedAllocator {
    network: NetworkMemory,
    cells: Vec<exact::Cell>,
    values: Vec<f32>,
    relation: Vec<f32>,
    team_max: usize,
    entry: &'static Entry,
    /// Where the search starts.
    start: Allocation,
}

impl LearnedAllocator {
    /// The plan of the bundle's team-value network, which has given its golden answers, or its graph.
    pub(crate) fn open(bundle: &Bundle, backend: Backend) -> Result<Self, Failure> {
        match backend {
            Backend::Plan => Self::of_plan(bundle, &plans()),
            Backend::Tract => Self::of_graph(bundle, engines()?.tract()),
        }
    }

    /// The plan that `plans` gives.
    pub(crate) fn of_plan(
        bundle: &Bundle,
        plans: &BundlePlans<CompilerProcess>,
    ) -> Result<Self, Failure> {
        Self::with(bundle, |_| NetworkMemory::of_plan(bundle, plans))
    }

    /// The graph in an engine, once another process has read and run it.
    pub(crate) fn of_graph(bundle: &Bundle, engine: &dyn GraphEngine) -> Result<Self, Failure> {
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
        let network = network(onnx).map_err(|error| Failure::from(error).within(&name))?;
        let limits = bundle.manifest().limits;
        let entities = usize::from(limits.n_max);
        let cells = exact::cells(EXACT_AGENTS, limits.t_max.into());
        let entry = entry_of(bundle)?;
        let start = usual_rule(entry).and_then(AllocatorChoice::rule);
        let start = start.ok_or_else(|| none_learned(&name.to_string()))?;
        Ok(Self {
            network,
            cells: vec![exact::Cell::default(); cells],
            values: vec![0.0; cells],
            relation: vec![0.0; entities * FrameRelation::new(entry)?.columns()],
            team_max: limits.team_max.into(),
            entry,
            start,
        })
    }

    /// The team-value network alone.
    pub(crate) fn network(&mut self) -> Result<impl TeamValueNetwork + '_, Failure> {
        self.network.bind()
    }

    /// Network and search.
    pub(crate) fn allocator(&mut self) -> Result<impl Allocator + '_, Failure> {
        Ok(TeamValueAllocator {
            network: self.network.bind()?,
            relation: FrameRelation::new(self.entry)?,
            start: RuleAllocator::new(self.entry, self.start, 0)?,
            team_max: self.team_max,
            exact_agents: EXACT_AGENTS,
            memory: SearchMemory {
                cells: &mut self.cells,
                values: &mut self.values,
                relation: &mut self.relation,
            },
        })
    }
}

/// No learned allocator where one was asked for.
pub(crate) fn none_learned(name: &str) -> Failure {
    let message = format!(
        "`{name}` has no learned allocator; choose a rule with --allocation, or a team that learned one"
    );
    Failure::new(Exit::Usage, message)
}

enum NetworkMemory {
    Plan { plan: AlignedBytes, arena: AlignedBytes, rows: Vec<f32> },
    Graph(Box<dyn TeamValueNetwork>),
}

enum BoundNetwork<'a> {
    Plan(Box<PlanTeamValue<'a>>),
    Graph(&'a mut dyn TeamValueNetwork),
}

impl NetworkMemory {
    fn of_plan(
        bundle: &Bundle,
        plans: &BundlePlans<CompilerProcess>,
    ) -> Result<Self, CompileError> {
        let plan = plans.allocator(bundle)?.ok_or(PlanError::WrongNetwork)?;
        let loaded = Plan::load(plan.as_slice())?;
        let arena = AlignedBytes::zeroed(loaded.batch_arena_bytes(sortie_core::limits::AGENTS));
        let entities = usize::from(bundle.manifest().limits.n_max);
        let rows = vec![0.0; PlanTeamValue::memory_floats(&loaded, entities)];
        Ok(Self::Plan { plan, arena, rows })
    }

    fn bind(&mut self) -> Result<BoundNetwork<'_>, Failure> {
        match self {
            Self::Plan { plan, arena, rows } => {
                let network = Plan::load(plan.as_slice())
                    .and_then(|plan| PlanTeamValue::new(plan, arena.as_mut_slice(), rows))
                    .map_err(CompileError::from)?;
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
