//! Crafting: from logs to iron and diamond, a game of [`milestones`](crate::milestones).

mod affordances;
mod numbers;
mod rules;

pub use rules::Crafting;

/// How `--env` finds it.
pub const ENTRY: crate::Entry = crate::milestones::entry::<Crafting>();
