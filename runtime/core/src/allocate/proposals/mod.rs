//! The allocator that proposes: a policy draws allocations, agent by agent, and a critic chooses the best of them
//! (dissertation section 7.4).
//!
//! Everything that proposals have in common is computed once, which changes no result: the trunk, what an agent adds to
//! the subtask that it chooses, subtasks that got the same agents in the same order, the critic's rows of an entity
//! among equally many agents, and allocations that were proposed twice. The draws are those of [`Draw`]; with
//! [`GumbelDraw`] the same seed and state give the same allocation on every call and in every process.

mod critic;
mod draw;
mod memory;
mod scene;
mod step;
mod trunk;

pub use draw::{Draw, GumbelDraw, largest_open};

pub use crate::ops::proposal_arena::{PROPOSALS, TOGETHER, arena_floats};

use draw::scramble;
use memory::Memory;
use scene::Scene;

use crate::allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use crate::entity_mask::EntityMask;
use crate::kernels::Kernels;
use crate::kernels::build::Work;
use crate::limits;
use crate::ops::ProposalNetwork;
use crate::ops::proposal_arena::{Extent, floats};
use crate::plan::{Network, Plan, PlanError};

/// Allocates by the best of several proposals.
///
/// Present agents get an open subtask each; absent ones, and everybody where no subtask is open, are [`UNASSIGNED`].
#[derive(Debug)]
pub struct ProposalAllocator<'a> {
    plan: Plan<'a>,
    network: ProposalNetwork,
    arena: &'a mut [u8],
    proposals: usize,
    seed: u64,
}

impl<'a> ProposalAllocator<'a> {
    /// Binds an allocator's plan to its arena, which holds `proposals` proposals. One is the greedy allocation;
    /// the others are drawn by noise from the seed.
    ///
    /// # Errors
    /// The plan is another network's, or the arena too small for so many proposals, see [`Self::arena_bytes`].
    pub fn new(
        plan: Plan<'a>,
        arena: &'a mut [u8],
        proposals: usize,
        seed: u64,
    ) -> Result<Self, PlanError> {
        plan.check_network(Network::Proposals)?;
        let network = plan.program().proposal_network().ok_or(PlanError::WrongNetwork)?;
        let (need, got) = (Self::arena_bytes(&plan, proposals), arena.len());
        if got < need {
            return Err(PlanError::ArenaTooSmall { need, got });
        }
        plan.check_arena_alignment(arena)?;
        let proposals = proposals.clamp(1, limits::PROPOSALS);
        Ok(Self { plan, network, arena, proposals, seed })
    }

    /// Bytes of arena for so many proposals, at most [`limits::PROPOSALS`]. A plan's own
    /// [`arena_bytes`](Plan::arena_bytes) are those of [`PROPOSALS`].
    pub fn arena_bytes(plan: &Plan<'_>, proposals: usize) -> usize {
        let n_max = plan.header().n_max as usize;
        let proposals = proposals.clamp(1, limits::PROPOSALS);
        let network = plan.program().proposal_network();
        let floats = network.map_or(0, |network| floats(&network, n_max, proposals));
        usize::try_from(floats.saturating_mul(4)).unwrap_or(usize::MAX)
    }

    /// The plan.
    pub fn plan(&self) -> &Plan<'a> {
        &self.plan
    }

    /// Proposes allocations as `draw` says, and values them.
    ///
    /// # Errors
    /// `TooLarge` or `BadLength` where the state does not fit, `NonFinite` where a feature or a result is no finite
    /// number, `Infeasible` where a draw is not open.
    pub fn propose(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut impl Draw,
    ) -> Result<Proposals<'_>, AllocateError> {
        let (header, agents) = (self.plan.header(), state.agents);
        let entities = state.entity_task.len();
        if entities > header.n_max as usize
            || agents > entities.min(limits::AGENTS)
            || state.tasks > self.network.trunk.task_count()
        {
            return Err(AllocateError::TooLarge);
        }
        let enough = state.rows.len() >= entities.saturating_mul(state.stride);
        let known = u64::from(state.open_tasks).checked_shr(state.tasks as u32).unwrap_or(0) == 0;
        if !(enough && known && state.stride >= header.features as usize) {
            return Err(AllocateError::BadLength);
        }
        let present = state.present.and(&EntityMask::first(entities));
        let anybody = present.iter().any(|entity| entity < agents);
        if !anybody || state.open_tasks == 0 {
            return Ok(Proposals { places: &[], values: &[], agents });
        }
        let extent = Extent { entities, agents, proposals: self.proposals };
        let weights = self.plan.weights();
        let scene = Scene { state, network: &self.network, weights, extent, present };
        let memory = Memory::new(&self.network, &extent, self.arena);
        let mut memory = memory.ok_or(AllocateError::TooLarge)?;
        draw.propose(&self.plan, scene, &mut memory)?;
        let values = memory.critic.of_proposal.cells.get(..self.proposals);
        let values = values.ok_or(AllocateError::TooLarge)?;
        Ok(Proposals { places: memory.step.places.cells, values, agents })
    }
}

impl Allocator for ProposalAllocator<'_> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let mut draw = GumbelDraw {
            seed: self.seed ^ fingerprint(state, self.plan.header().features as usize),
        };
        let proposals = self.propose(state, &mut draw)?;
        let best = proposals.best().unwrap_or(0);
        for (to, place) in allocation.iter_mut().zip(proposals.allocation(best)) {
            *to = place;
        }
        Ok(())
    }
}

/// What was proposed, and what each proposal is worth. Nothing is proposed where nobody can be assigned.
#[derive(Clone, Copy, Debug)]
pub struct Proposals<'a> {
    places: &'a [u16],
    values: &'a [f32],
    agents: usize,
}

impl Proposals<'_> {
    /// The value of every proposal.
    pub fn values(&self) -> &[f32] {
        self.values
    }

    /// The proposal of the highest value, the first of several; none where nothing was proposed.
    pub fn best(&self) -> Option<usize> {
        let first = self.values.first()?;
        let better = |best: (usize, f32), (index, value): (usize, &f32)| {
            if *value > best.1 { (index, *value) } else { best }
        };
        Some(self.values.iter().enumerate().fold((0, *first), better).0)
    }

    /// The subtasks `[A]` of a proposal; where there is no such proposal nobody is assigned.
    pub fn allocation(&self, proposal: usize) -> impl Iterator<Item = u8> + '_ {
        let start = proposal.saturating_mul(self.agents);
        let places = self.places.get(start..).unwrap_or(&[]).iter();
        // What stands for no subtask does not fit into a byte.
        let places = places.map(|place| u8::try_from(*place).unwrap_or(UNASSIGNED));
        places.chain(core::iter::repeat(UNASSIGNED)).take(self.agents)
    }
}

/// One run of all three networks.
struct Proposing<'p, 'a, D> {
    scene: Scene<'p>,
    memory: &'p mut Memory<'a>,
    draw: &'p mut D,
}

impl<D: Draw> Work for Proposing<'_, '_, D> {
    type Output = Result<(), AllocateError>;

    #[inline(always)]
    fn run(self, kernels: impl Kernels) -> Self::Output {
        let Memory { trunk, step, critic, scores } = self.memory;
        trunk::embed(kernels, &self.scene, trunk, step, critic, scores)?;
        step::propose(kernels, &self.scene, trunk, step, critic.keys.cells, self.draw)?;
        critic::score(kernels, &self.scene, step, critic, scores)
    }
}

/// A number that depends on subtasks, entities and the first `columns` features of each, so that other states get other noise,
/// and the same state the same noise whoever computes it and whatever it has computed before.
pub fn fingerprint(state: &AllocationState<'_>, columns: usize) -> u64 {
    let mut word = [state.open_tasks, state.agents as u32];
    let mut mix = |value: u32| {
        let [low, high] = word;
        word = [scramble(low ^ value), high.rotate_left(5).wrapping_add(low ^ value)];
    };
    let rows = state.rows.chunks(state.stride.max(1)).zip(state.entity_task).enumerate();
    for (entity, (row, tasks)) in rows {
        if state.present.contains(entity) {
            mix(*tasks ^ (entity as u32) << 24);
            for feature in row.iter().take(columns) {
                mix(feature.to_bits());
            }
        }
    }
    let [low, high] = word;
    u64::from(high) << 32 | u64::from(low)
}
