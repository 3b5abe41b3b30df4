//! The program of a plan: what is computed, one operator after the other.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::error::PlanError;
use crate::ops::{Op, Place, Sizes};

/// Most operators of one program.
pub const OPS: usize = 16;

/// The operators in order, and what the arena holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    /// The operators; the first embeds entities, the last chooses the action.
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
        let Some(Op::EmbedEntities(embed)) = self.ops.first() else { return None };
        let shared = embed.rows.len;
        let own = self.floats.checked_sub(shared).filter(|own| *own > 0)?;
        self.ops.iter().all(|op| op.works_for_teams(shared)).then_some(own)
    }

    /// Where the utilities stand after the program ran.
    pub fn utilities(&self) -> Option<Place> {
        match self.ops.last() {
            Some(Op::MaskedArgmax(op)) => Some(op.from),
            _ => None,
        }
    }

    /// Checks every operator, and that rows are embedded before anything attends to them.
    pub(super) fn check(&self, sizes: &Sizes) -> Result<(), PlanError> {
        for (index, op) in self.ops.iter().enumerate() {
            let first = matches!(op, Op::EmbedEntities(_)) == (index == 0);
            let last = matches!(op, Op::MaskedArgmax(_)) == (index + 1 == self.ops.len());
            if !(first && last && self.reads_written_rows(op) && op.check(sizes)) {
                return Err(PlanError::ShapeMismatch { op: index });
            }
        }
        self.utilities().map(|_| ()).ok_or(PlanError::ShapeMismatch { op: self.ops.len() })
    }

    fn reads_written_rows(&self, op: &Op) -> bool {
        match (op, self.ops.first()) {
            (Op::AttendOwn(attend), Some(Op::EmbedEntities(embed))) => {
                attend.rows == embed.rows && attend.width == embed.layer.outputs
            }
            (Op::AttendOwn(_), _) => false,
            _ => true,
        }
    }
}
