//! What networks over all entities read: critics and the trunks of allocators.

use crate::entity_mask::EntityMask;

/// All entities of one step. N entities, d features, up to 32 groups.
#[derive(Clone, Copy, Debug)]
pub struct Entities<'a> {
    /// Features `[N, stride]`; the first d columns of a row count.
    pub rows: &'a [f32],
    /// Columns of a row, d or more.
    pub stride: usize,
    /// The entities that exist; rows of others are never read.
    pub present: EntityMask,
    /// The agents among the entities, present or not.
    pub agents: EntityMask,
    /// The groups `[N]` of every entity, its subtasks for instance: bit t for group t.
    pub groups: &'a [u32],
}
