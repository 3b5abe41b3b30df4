//! What there is to see in one state.

use alloc::vec;
use alloc::vec::Vec;

use crate::rows::SparseRows;
use crate::spec::Shape;

/// Entities as bits: bit e stands for entity e.
pub type EntitySet = u128;

/// Agents as bits.
pub type AgentSet = u64;

/// Actions as bits.
pub type ActionSet = u64;

/// The members of a set, lowest first.
pub fn members(set: EntitySet) -> impl Iterator<Item = usize> {
    let mut left = set;
    core::iter::from_fn(move || {
        let member = (left != 0).then(|| left.trailing_zeros() as usize)?;
        left &= left - 1;
        Some(member)
    })
}

/// What there is to see in one state; filled by [`Environment::observe`](crate::Environment::observe).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observation {
    /// The entities that have a row: those that exist and were wanted.
    pub entities: EntitySet,
    /// Their features, in rising order of the entities.
    pub rows: SparseRows,
    /// The entities that exist. Agents are the first of all entities, and those that exist the first of them.
    pub present: EntitySet,
    /// `[A]`: the entities that each agent can observe; empty for absent agents.
    pub observable: Vec<EntitySet>,
    /// `[N]`: the subtasks, as bits, that each entity belongs to by itself; none for agents and absent entities.
    pub entity_task: Vec<u32>,
    /// `[A]`: the actions that each agent may take; action 0 alone for absent agents.
    pub available: Vec<ActionSet>,
    /// The subtasks that exist and are not finished.
    pub open_tasks: u32,
}

impl Observation {
    /// Room for the observation of an environment of this shape.
    pub fn new(shape: &Shape) -> Self {
        Self {
            observable: vec![0; shape.agents],
            entity_task: vec![0; shape.entities],
            available: vec![1; shape.agents],
            ..Self::default()
        }
    }

    /// Number of agents that exist.
    pub fn agents(&self) -> usize {
        let agents = self.observable.len() as u32;
        (self.present.trailing_ones().min(agents)) as usize
    }

    /// The row in [`rows`](Self::rows) of an entity that has one.
    #[inline]
    pub fn row_of(&self, entity: usize) -> usize {
        (self.entities & ((1 << entity) - 1)).count_ones() as usize
    }
}
