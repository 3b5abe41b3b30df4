//! What games on a grid with milestones have in common (dissertation chapter 6).
//!
//! Agrees bit for bit with the dissertation's public code from the same state, actions and lost items. One agent sees a
//! window around itself, turned so that it faces up, and counts what it carries. [`Spec::milestones`] are what can be
//! reached on the way to the task, the last of them; [`Environment::affordances`] says which of them can be next.
//!
//! [`Spec::milestones`]: crate::Spec::milestones
//! [`Environment::affordances`]: crate::Environment::affordances

mod environment;
mod observation;
mod rules;
pub(crate) mod world;

pub use environment::Milestones;
pub(crate) use environment::entry;
pub use observation::{RADIUS, WINDOW, window};
pub use rules::{MilestoneSet, Rules};
pub(crate) use world::{EMPTY, ITEMS, WALL};
pub use world::{Effect, Game, World};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
