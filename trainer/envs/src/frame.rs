//! What can be read back from feature rows: allocation in processes that see messages alone.

use core::fmt;

use sortie_core::AllocationState;

use crate::observation::EntitySet;
use crate::random::Random;

/// The parts of a message that describe a state.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Features `[N, stride]`; N entities, the agents first.
    pub rows: &'a [f32],
    /// Columns of a row; those behind the features do not count.
    pub stride: usize,
    /// Agent rows A, present or not. It may be another number than the environment's own.
    pub agents: usize,
    /// Subtasks T, present or not.
    pub tasks: usize,
    /// The entities that exist; bit e stands for row e.
    pub present: EntitySet,
    /// The subtasks that are not finished.
    pub open_tasks: u32,
    /// Of every agent `[A, U]` its actions, 0 where one is not available; empty where nobody tells.
    pub available: &'a [u16],
}

impl<'a> Frame<'a> {
    /// What an allocator is told of a state.
    pub fn of(state: &AllocationState<'a>) -> Self {
        let word = |index| u128::from(state.present.words().get(index).copied().unwrap_or(0));
        Self {
            rows: state.rows,
            stride: state.stride,
            agents: state.agents,
            tasks: state.tasks,
            present: word(0) | word(1) << 64,
            open_tasks: state.open_tasks,
            available: state.available,
        }
    }
}

/// Reads states back from feature rows, as far as rules of allocation look at them.
pub trait FrameReader: Send {
    /// Reads the state that all that follows is about.
    ///
    /// # Errors
    /// The rows describe no state; nothing may be asked until others are read.
    fn read(&mut self, frame: &Frame<'_>) -> Result<(), FrameError>;

    /// Writes for every agent row `[A]` an open subtask by one of the [rules](crate::Spec::rules), or `None` (255),
    /// which absent agents and further entries get.
    ///
    /// # Errors
    /// There is no room for all agents.
    fn allocate(
        &mut self,
        rule: usize,
        random: &mut Random,
        allocation: &mut [u8],
    ) -> Result<(), FrameError>;

    /// Columns of a [relation](crate::Spec::relations).
    fn relations(&self) -> usize;

    /// Writes the relation `[N, relations]` of every row to a subtask; zeros where there is none.
    fn relate(&self, task: usize, relation: &mut [f32]);
}

/// Rows that no state can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameError {
    /// The rows or the allocation are shorter than the counts say, or a row has too few columns.
    BadLength,
    /// More agents or subtasks than a state can have.
    TooLarge,
    /// A feature of this entity is not a finite number.
    NonFinite {
        /// The entity's row.
        entity: usize,
    },
    /// The row of this entity describes none that there can be.
    BadRow {
        /// The entity's row.
        entity: usize,
    },
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BadLength => f.write_str("the feature rows are too short"),
            Self::TooLarge => f.write_str("more agents or subtasks than a state can have"),
            Self::NonFinite { entity } => write!(f, "a feature of entity {entity} is not finite"),
            Self::BadRow { entity } => write!(f, "the row of entity {entity} describes none"),
        }
    }
}

impl core::error::Error for FrameError {}
