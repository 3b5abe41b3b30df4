//! The arena of an allocator that proposes, part by part.

use zerocopy::FromBytes;

use crate::ops::ProposalNetwork;
use crate::ops::proposal_arena::{Extent, LINE, Size, TABLE_LINE, float_parts, table_parts};

/// Stands for what is not there yet.
pub(super) const NONE: u16 = u16::MAX;

/// Rows of numbers. A row that does not exist is empty.
#[derive(Debug)]
pub(super) struct Grid<'a, V> {
    pub(super) cells: &'a mut [V],
    /// Numbers of a row, at least one.
    pub(super) width: usize,
}

impl<V: Copy> Grid<'_, V> {
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> &[V] {
        let start = row.saturating_mul(self.width);
        self.cells.get(start..start.saturating_add(self.width)).unwrap_or(&[])
    }

    #[inline(always)]
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [V] {
        let start = row.saturating_mul(self.width);
        self.cells.get_mut(start..start.saturating_add(self.width)).unwrap_or(&mut [])
    }
}

impl Grid<'_, u16> {
    /// A number; [`NONE`] where there is none.
    #[inline(always)]
    pub(super) fn get(&self, row: usize, column: usize) -> u16 {
        self.row(row).get(column).copied().unwrap_or(NONE)
    }

    #[inline(always)]
    pub(super) fn set(&mut self, row: usize, column: usize, value: u16) {
        if let Some(cell) = self.row_mut(row).get_mut(column) {
            *cell = value;
        }
    }
}

/// All parts of the arena.
pub(super) struct Memory<'a> {
    pub(super) trunk: TrunkMemory<'a>,
    pub(super) step: StepMemory<'a>,
    pub(super) critic: CriticMemory<'a>,
    /// Scores of one query.
    pub(super) scores: Grid<'a, f32>,
}

/// What the trunk computes. Rows belong to entities.
pub(super) struct TrunkMemory<'a> {
    /// Embeddings, before any ReLU.
    pub(super) embedded: Grid<'a, f32>,
    /// The same behind a ReLU.
    pub(super) active: Grid<'a, f32>,
    pub(super) queries: Grid<'a, f32>,
    pub(super) keys: Grid<'a, f32>,
    pub(super) values: Grid<'a, f32>,
    /// What the heads attended to.
    pub(super) mixed: Grid<'a, f32>,
    pub(super) attended: Grid<'a, f32>,
    /// What each agent adds to the update of the subtask that it chooses.
    pub(super) from_agents: Grid<'a, f32>,
}

/// What proposals share, and what they consist of.
pub(super) struct StepMemory<'a> {
    /// Embeddings of subtasks: first those without agents, then what choices made of them.
    pub(super) nodes: Grid<'a, f32>,
    /// The product of each node and the agent in question.
    pub(super) products: Grid<'a, f32>,
    /// Nodes whose updates are computed, behind a ReLU.
    pub(super) parents: Grid<'a, f32>,
    /// `[T, P]`, rows of whole [`TOGETHER`]: the node that each subtask has come to.
    pub(super) node_of: Grid<'a, u16>,
    /// The same: agents of each subtask.
    pub(super) counts: Grid<'a, u16>,
    /// `[P, A]`: the subtask of each agent.
    pub(super) places: Grid<'a, u16>,
    /// The node that a node becomes by the agent in question.
    pub(super) children: Grid<'a, u16>,
    /// The nodes that become new ones.
    pub(super) parent_of: Grid<'a, u16>,
    /// The update that nodes add to those that become of them.
    pub(super) update_of: Grid<'a, u16>,
}

/// What the critic computes.
pub(super) struct CriticMemory<'a> {
    /// Embedded features by entity.
    pub(super) bases: Grid<'a, f32>,
    /// Distinct rows; at the end, what agents attended to.
    pub(super) rows: Grid<'a, f32>,
    pub(super) queries: Grid<'a, f32>,
    /// Until it is the critic's turn, updates of nodes stand here.
    pub(super) keys: Grid<'a, f32>,
    pub(super) values: Grid<'a, f32>,
    /// What the heads of each agent of each distinct allocation attended to.
    pub(super) mixed: Grid<'a, f32>,
    pub(super) mean: Grid<'a, f32>,
    /// The value of every proposal.
    pub(super) of_proposal: Grid<'a, f32>,
    /// `[P, N]`: the rows of each distinct allocation, one for each present entity.
    pub(super) rows_of: Grid<'a, u16>,
    /// The first proposal of each distinct allocation.
    pub(super) distinct: Grid<'a, u16>,
    /// The distinct allocation that each proposal is.
    pub(super) same_as: Grid<'a, u16>,
}

impl<'a> Memory<'a> {
    /// Cuts the arena up; none where it is too small.
    pub(super) fn new(
        network: &ProposalNetwork,
        extent: &Extent,
        arena: &'a mut [u8],
    ) -> Option<Self> {
        let parts = float_parts(network, extent);
        let lines: usize = parts.iter().map(|(rows, width)| (rows * width).div_ceil(LINE)).sum();
        let (floats, rest) = arena.split_at_mut_checked(4 * LINE * lines)?;
        let floats = <[f32]>::mut_from_bytes(floats).ok()?;
        let rest = rest.get_mut(..rest.len() & !1)?;
        let tables = <[u16]>::mut_from_bytes(rest).ok()?;
        let [
            embedded,
            active,
            queries,
            keys,
            values,
            mixed,
            attended,
            from_agents,
            nodes,
            products,
            parents,
            bases,
            rows,
            row_queries,
            row_keys,
            row_values,
            row_mixed,
            mean,
            scores,
        ] = cut::<_, _, LINE>(floats, parts)?;
        let [node_of, counts, places, children, parent_of, update_of, rows_of, distinct, same_as] =
            cut::<_, _, TABLE_LINE>(tables, table_parts(network, extent))?;
        let [scores, of_proposal] = halves(scores)?;
        Some(Self {
            trunk: TrunkMemory {
                embedded,
                active,
                queries,
                keys,
                values,
                mixed,
                attended,
                from_agents,
            },
            step: StepMemory {
                nodes,
                products,
                parents,
                node_of,
                counts,
                places,
                children,
                parent_of,
                update_of,
            },
            critic: CriticMemory {
                bases,
                rows,
                queries: row_queries,
                keys: row_keys,
                values: row_values,
                mixed: row_mixed,
                mean,
                of_proposal,
                rows_of,
                distinct,
                same_as,
            },
            scores,
        })
    }
}

/// The two rows of a grid.
fn halves(grid: Grid<'_, f32>) -> Option<[Grid<'_, f32>; 2]> {
    let width = grid.width;
    let (first, second) = grid.cells.split_at_mut_checked(width)?;
    Some([Grid { cells: first, width }, Grid { cells: second, width }])
}

/// Cuts parts off, each starting at a cache line.
fn cut<'a, V, const PARTS: usize, const LINE: usize>(
    mut memory: &'a mut [V],
    sizes: [Size; PARTS],
) -> Option<[Grid<'a, V>; PARTS]> {
    let mut whole = true;
    let parts = sizes.map(|(rows, width)| {
        let count = rows * width;
        let part = memory.split_off_mut(..count.next_multiple_of(LINE));
        let cells = part.and_then(|part| part.get_mut(..count));
        whole &= cells.is_some();
        Grid { cells: cells.unwrap_or_default(), width: width.max(1) }
    });
    whole.then_some(parts)
}
