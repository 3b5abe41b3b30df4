//! Who allocates: rules and relations of an environment, read back from frames, and the memory of a learned allocator.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use sortie_core::allocate::proposals::fingerprint;
use sortie_core::allocate::{
    EXACT_AGENTS, PlanTeamValue, SearchMemory, TaskRelation, TeamValueAllocator, TeamValueNetwork,
    exact,
};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{AllocateError, AllocationState, Allocator, limits};
use sortie_envs::random::generator;
use sortie_envs::{Entry, Frame, FrameError, FrameReader};

/// A rule of allocation.
pub struct RuleAllocator {
    reader: Box<dyn FrameReader>,
    rule: usize,
    seed: u64,
}

impl RuleAllocator {
    /// The rule of this number; rules that draw do so by `seed` and the state, not by what was asked before. None where the environment reads no frames.
    pub fn new(entry: &Entry, rule: usize, seed: u64) -> Option<Self> {
        let rule = Some(rule).filter(|rule| *rule < entry.rules.len())?;
        Some(Self { reader: entry.reader?(), rule, seed })
    }
}

impl Allocator for RuleAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let read = self.reader.read(&Frame::of(state));
        let mut random = generator(self.seed ^ fingerprint(state, state.stride));
        read.and_then(|()| self.reader.allocate(self.rule, &mut random, allocation))
            .map_err(refusal)
    }
}

/// How entities stand to subtasks, which a learned allocator knows beside features.
pub struct FrameRelation(Box<dyn FrameReader>);

impl FrameRelation {
    /// Those of an environment; none where it reads no frames.
    pub fn new(entry: &Entry) -> Option<Self> {
        Some(Self(entry.reader?()))
    }
}

impl TaskRelation for FrameRelation {
    fn columns(&self) -> usize {
        self.0.relations()
    }

    fn observe(&mut self, state: &AllocationState<'_>) -> Result<(), AllocateError> {
        self.0.read(&Frame::of(state)).map_err(refusal)
    }

    fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        self.0.relate(task, relation);
    }
}

fn refusal(error: FrameError) -> AllocateError {
    match error {
        FrameError::TooLarge => AllocateError::TooLarge,
        FrameError::BadLength => AllocateError::BadLength,
        _ => AllocateError::NonFinite,
    }
}

/// A search by the values of a network that allocates.
pub type LearnedAllocator<'a, N> = TeamValueAllocator<'a, N, FrameRelation, RuleAllocator>;

/// What is searched.
#[derive(Clone, Copy, Debug)]
pub struct SearchSizes {
    /// Most entities N.
    pub entities: usize,
    /// Most subtasks T.
    pub tasks: usize,
    /// Largest team of one subtask.
    pub team_max: usize,
}

/// The memory of a search for the best allocation.
pub struct Search {
    cells: Vec<exact::Cell>,
    values: Vec<f32>,
    relation: Vec<f32>,
    team_max: usize,
    entry: &'static Entry,
}

impl Search {
    /// Memory for an environment; none where it has no rule to start from, or none of frames.
    pub fn new(entry: &'static Entry, sizes: SearchSizes) -> Option<Self> {
        let cells = exact::cells(EXACT_AGENTS, sizes.tasks);
        let columns = FrameRelation::new(entry)?.columns();
        let search = Self {
            cells: vec![exact::Cell::default(); cells],
            values: vec![0.0; cells],
            relation: vec![0.0; sizes.entities * columns],
            team_max: sizes.team_max,
            entry,
        };
        (!entry.rules.is_empty()).then_some(search)
    }

    /// The search by the values of this network, from the environment's usual rule on.
    pub fn allocator<N: TeamValueNetwork>(&mut self, network: N) -> LearnedAllocator<'_, N> {
        const READ: &str = "frames of the environment could be read when the memory was made";
        TeamValueAllocator {
            network,
            relation: FrameRelation::new(self.entry).expect(READ),
            start: RuleAllocator::new(self.entry, 0, 0).expect(READ),
            team_max: self.team_max,
            exact_agents: EXACT_AGENTS,
            memory: SearchMemory {
                cells: &mut self.cells,
                values: &mut self.values,
                relation: &mut self.relation,
            },
        }
    }
}

/// The plan of a network that values teams, with its memory.
pub struct TeamValuePlan {
    plan: AlignedBytes,
    arena: AlignedBytes,
    rows: Vec<f32>,
}

impl TeamValuePlan {
    /// Memory for states of so many entities.
    ///
    /// # Errors
    /// The bytes are no plan.
    pub fn new(plan: AlignedBytes, entities: usize) -> Result<Self, PlanError> {
        let loaded = Plan::load(plan.as_slice())?;
        let arena = AlignedBytes::zeroed(loaded.batch_arena_bytes(limits::AGENTS));
        let rows = vec![0.0; PlanTeamValue::memory_floats(&loaded, entities)];
        Ok(Self { plan, arena, rows })
    }

    /// The network.
    ///
    /// # Errors
    /// The plan is another network's.
    pub fn bind(&mut self) -> Result<PlanTeamValue<'_>, PlanError> {
        let Self { plan, arena, rows } = self;
        PlanTeamValue::new(Plan::load(plan.as_slice())?, arena.as_mut_slice(), rows)
    }
}
