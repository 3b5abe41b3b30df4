//! How large the arena of an allocator that proposes is, part by part.

use super::ProposalNetwork;
use crate::kernels::softmax::slots;
use crate::limits;

/// Proposals that a plan's arena holds by default.
pub const PROPOSALS: usize = 32;

/// Most proposals that are drawn in together.
pub const TOGETHER: usize = 16;

/// Floats that every part starts at a multiple of: one cache line.
pub(crate) const LINE: usize = 16;
/// The same for numbers of tables.
pub(crate) const TABLE_LINE: usize = 2 * LINE;

/// How much there is of everything.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    /// Entities N.
    pub(crate) entities: usize,
    /// Agents A.
    pub(crate) agents: usize,
    /// Proposals P.
    pub(crate) proposals: usize,
}

impl Extent {
    /// The most that a plan for `n_max` entities is asked about.
    pub(crate) fn largest(n_max: usize, proposals: usize) -> Self {
        Self { entities: n_max, agents: n_max.min(limits::AGENTS), proposals }
    }

    /// Embeddings of subtasks: without agents, and after every choice of every proposal.
    fn nodes(&self, tasks: usize) -> usize {
        tasks + self.proposals * self.agents
    }
}

/// Rows and columns of a part.
pub(crate) type Size = (usize, usize);

/// Rows and columns of all parts that hold floats, in the order in which they are cut off.
pub(crate) fn float_parts(network: &ProposalNetwork, extent: &Extent) -> [Size; 19] {
    let ProposalNetwork { trunk, critic, .. } = network;
    let (width, inner) = (trunk.embed.padded_outputs(), trunk.attention.inner());
    let (critic_width, critic_inner) = (critic.embed.padded_outputs(), critic.attention.inner());
    let Extent { entities, agents, proposals, .. } = *extent;
    let nodes = extent.nodes(trunk.task_count());
    let rows = proposals * entities;
    // Every agent but the last has at most one update for each proposal.
    let updates = (proposals * agents * width).div_ceil(critic_inner.max(1));
    [
        (entities, width),
        (entities, width),
        (entities, inner),
        (entities, inner),
        (entities, inner),
        (entities, inner),
        (entities, width),
        (agents, width),
        (nodes, width),
        // Products are written four at a time.
        (1, nodes.next_multiple_of(4)),
        (proposals, width),
        (entities, critic_width),
        (rows, critic_width),
        (rows, critic_inner),
        (rows.max(updates), critic_inner),
        (rows, critic_inner),
        (proposals * agents, critic_inner),
        (1, critic_width),
        (2, slots(entities).max(proposals)),
    ]
}

/// The same for tables of numbers.
pub(crate) fn table_parts(network: &ProposalNetwork, extent: &Extent) -> [Size; 9] {
    let Extent { entities, agents, proposals, .. } = *extent;
    let tasks = network.trunk.task_count();
    let lanes = proposals.next_multiple_of(TOGETHER);
    [
        (tasks, lanes),
        (tasks, lanes),
        (proposals, agents),
        (1, extent.nodes(tasks)),
        (1, proposals),
        (1, extent.nodes(tasks)),
        (proposals, entities),
        (1, proposals),
        (1, proposals),
    ]
}

/// Floats of the arena for so many entities and proposals.
pub(crate) fn floats(network: &ProposalNetwork, n_max: usize, proposals: usize) -> u64 {
    let extent = Extent::largest(n_max, proposals);
    let count = |(rows, width): &Size| (*rows as u64).saturating_mul(*width as u64);
    let of_floats = float_parts(network, &extent);
    let of_floats: u64 = of_floats.iter().map(|part| count(part).div_ceil(LINE as u64)).sum();
    let of_tables = table_parts(network, &extent);
    let of_tables: u64 = of_tables.iter().map(|part| count(part).div_ceil(TABLE_LINE as u64)).sum();
    of_floats.saturating_add(of_tables).saturating_mul(LINE as u64)
}

/// Floats of a plan's arena, which holds [`PROPOSALS`] proposals for `n_max` entities.
pub fn arena_floats(network: &ProposalNetwork, n_max: usize) -> u64 {
    floats(network, n_max, PROPOSALS)
}
