//! The program of a plan: what is computed, one operator after the other.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::error::PlanError;
use super::header::{Header, Network};
use crate::ops::proposal_arena::arena_floats;
use crate::ops::{Gru, Op, OperatorSet, Output, OutputRows, Place, ProposalNetwork, Sizes};

/// Most operators of one program.
pub const OPS: usize = 16;

/// The operators in order, and what the arena holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    /// The operators; the first embeds entities, the last chooses the action or is an output.
    pub ops: Vec<Op, OPS>,
    /// Floats of the arena.
    pub floats: u32,
    /// Marks behind the floats, which say which of 64 inputs are not zero.
    pub nonzeros: u32,
}

impl Program {
    /// Bytes of arena: floats, then marks of two words.
    pub fn arena_bytes(&self) -> u64 {
        4 * u64::from(self.floats) + 8 * u64::from(self.nonzeros)
    }

    /// Floats of an agent's own places, behind the rows that a team shares; none where one agent is worked on
    /// after the other.
    pub fn own_floats(&self) -> Option<u32> {
        let (rows, _) = self.ops.first().and_then(embedded)?;
        let shared = rows.len;
        let own = self.floats.checked_sub(shared).filter(|own| *own > 0)?;
        self.ops.iter().all(|op| op.works_for_teams(shared)).then_some(own)
    }

    /// Where the utilities stand after the program ran.
    pub fn utilities(&self) -> Option<Place> {
        match self.ops.last() {
            Some(Op::MaskedArgmax(op)) => Some(op.from),
            Some(Op::MaskedSample(op)) => Some(op.from),
            _ => None,
        }
    }

    /// Whether the utilities are logits to draw an action from.
    pub fn draws(&self) -> bool {
        matches!(self.ops.last(), Some(Op::MaskedSample(_)))
    }

    /// What the program remembers from one run to the next.
    pub fn memory(&self) -> Option<&Gru> {
        self.ops.iter().find_map(|op| match op {
            Op::Gru(gru) => Some(gru),
            _ => None,
        })
    }

    /// Whether the layer behind the attention takes the own row as well.
    pub fn skips(&self) -> bool {
        self.ops.iter().any(skips)
    }

    /// What the caller of a network over all entities reads, in order.
    pub fn outputs(&self) -> impl Iterator<Item = &Output> {
        self.ops.iter().filter_map(|op| match op {
            Op::Output(output) => Some(output),
            _ => None,
        })
    }

    /// The network of an allocator that proposes.
    pub fn proposal_network(&self) -> Option<ProposalNetwork> {
        match self.ops.as_slice() {
            [Op::EmbedTasks(trunk), Op::PointerLogits(step), Op::ScoreAllocations(critic)] => {
                Some(ProposalNetwork { trunk: *trunk, step: *step, critic: *critic })
            }
            _ => None,
        }
    }

    /// Checks the operators of an allocator that proposes, and that the arena is at least as large as they need it.
    fn check_proposals(&self, sizes: &Sizes, header: &Header) -> Result<(), PlanError> {
        for (index, op) in self.ops.iter().enumerate() {
            if !(op.check(sizes) && op.kind().fits(header.layout)) {
                return Err(PlanError::ShapeMismatch { op: index });
            }
        }
        let network = self.proposal_network().filter(|network| {
            network.fits()
                && usize::from(header.t_max) == network.trunk.task_count()
                && u64::from(self.floats) >= arena_floats(network, sizes.n_max as usize)
                && (self.nonzeros, sizes.hidden) == (0, 0)
        });
        network.map(drop).ok_or(PlanError::ShapeMismatch { op: self.ops.len() })
    }

    /// Checks every operator, that rows are embedded before anything reads them, and that the program ends as
    /// its network does: with one choice, or with outputs.
    pub(super) fn check<S: OperatorSet>(
        &self,
        sizes: &Sizes,
        header: &Header,
    ) -> Result<(), PlanError> {
        if !self.ops.iter().all(|op| S::OPERATORS.contains(&op.kind())) {
            return Err(PlanError::UnknownOp);
        }
        if header.network == Network::Proposals {
            return self.check_proposals(sizes, header);
        }
        let is_end = |op: &Op| match header.network {
            Network::Entities => matches!(op, Op::Output(_)),
            Network::Proposals => false,
            Network::Agent | Network::TeamValue => {
                matches!(op, Op::MaskedArgmax(_) | Op::MaskedSample(_))
            }
        };
        let mut units = 0;
        let mut ends = 0;
        for (index, op) in self.ops.iter().enumerate() {
            let first = embedded(op).is_some() == (index == 0);
            let is_choice = matches!(op, Op::MaskedArgmax(_) | Op::MaskedSample(_));
            let in_place = match op {
                Op::MaskedArgmax(_) | Op::MaskedSample(_) | Op::Output(_) => is_end(op),
                Op::EmbedTasks(_) | Op::PointerLogits(_) | Op::ScoreAllocations(_) => false,
                _ => ends == 0,
            };
            units += u32::from(matches!(op, Op::Gru(_)));
            ends += u32::from(is_end(op));
            let alone = !is_choice || ends == 1;
            let fits = first && in_place && alone && units <= 1 && op.kind().fits(header.layout);
            if !(fits && self.reads_written_rows(index, op) && op.check(sizes)) {
                return Err(PlanError::ShapeMismatch { op: index });
            }
        }
        let remembered = self.memory().map_or(0, |gru| u32::from(gru.size));
        // A network over all entities has no own row.
        let fits_skip =
            self.skips() == header.skip && !(header.skip && header.network == Network::Entities);
        if ends == 0 || remembered != sizes.hidden || !fits_skip {
            return Err(PlanError::ShapeMismatch { op: self.ops.len() });
        }
        Ok(())
    }

    /// Whether the rows that an operator reads are rows that an earlier one wrote.
    fn reads_written_rows(&self, index: usize, op: &Op) -> bool {
        let (place, width) = match op {
            Op::AttendOwn(op) => (op.rows, op.width),
            Op::Int8AttendOwn(op) => (op.rows, op.width),
            Op::AttendAll(op) => (op.rows, op.width),
            Op::MeanRows(op) => (op.rows, op.width),
            Op::GroupSum(op) => (op.rows, op.width),
            Op::Output(Output { from, width, rows: OutputRows::Entities }) => (*from, *width),
            _ => return true,
        };
        let own = matches!(op, Op::AttendOwn(_) | Op::Int8AttendOwn(_));
        self.ops.iter().take(index).any(|before| match before {
            Op::EmbedEntities(_) | Op::Int8EmbedEntities(_) => {
                embedded(before) == Some((place, width))
            }
            // It writes no row for an agent that does not see itself.
            Op::AttendAll(before) => !own && (before.to, before.output.outputs) == (place, width),
            _ => false,
        })
    }
}

fn skips(op: &Op) -> bool {
    match op {
        Op::AttendOwn(op) => op.skips(),
        Op::Int8AttendOwn(op) => op.skips(),
        _ => false,
    }
}

/// The rows that an operator embeds, and their width.
fn embedded(op: &Op) -> Option<(Place, u16)> {
    match op {
        Op::EmbedEntities(op) => Some((op.rows, op.layer.outputs)),
        Op::Int8EmbedEntities(op) => Some((op.rows, op.layer.outputs)),
        _ => None,
    }
}
