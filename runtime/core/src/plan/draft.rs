//! Programs as compilers build them.

use std::vec::Vec;

use super::{AlignedBytes, Program};
use crate::ops::{Op, OpRef, OperatorSet};

/// A program that is being built.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProgramDraft {
    /// The operators, in order.
    pub ops: Vec<Op>,
    /// Floats of the arena.
    pub floats: u32,
    /// Marks behind the floats, each of 64 inputs.
    pub nonzeros: u32,
}

impl ProgramDraft {
    /// A program to be changed.
    pub fn of<S: OperatorSet>(program: &Program<'_, S>) -> Self {
        let ops = program.ops().map(OpRef::to_op).collect();
        Self { ops, floats: program.floats(), nonzeros: program.nonzeros() }
    }

    /// The program as a plan holds it and [`Program::read`] reads it.
    pub fn to_bytes(&self) -> AlignedBytes {
        let mut bytes = Vec::new();
        bytes.extend(self.floats.to_le_bytes());
        bytes.extend(self.nonzeros.to_le_bytes());
        for op in &self.ops {
            let fields = op.borrow().fields();
            bytes.extend((op.borrow().kind() as u16).to_le_bytes());
            bytes.extend(((fields.len() / 4) as u16).to_le_bytes());
            bytes.extend(fields);
        }
        AlignedBytes::copy_of(&bytes)
    }
}
