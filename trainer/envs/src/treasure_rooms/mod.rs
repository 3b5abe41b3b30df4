//! A treasure behind locked rooms, a game of [`milestones`](crate::milestones): keys open doors, one thing fits the hand.

mod affordances;
mod numbers;
mod rules;

pub use rules::TreasureRooms;

/// How `--env` finds it.
pub const ENTRY: crate::Entry = crate::milestones::entry::<TreasureRooms>();
