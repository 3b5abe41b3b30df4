//! The sizes that everybody of a domain agrees on.

/// Padded sizes of a domain; a bundle's limits must cover them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Shape {
    /// Agents A.
    pub agents: usize,
    /// Entities N, agents included.
    pub entities: usize,
    /// Subtasks T.
    pub tasks: usize,
    /// Actions U of one agent.
    pub actions: usize,
    /// Features d of one entity, without its last action.
    pub features: usize,
}
