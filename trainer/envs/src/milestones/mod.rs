//! What games on a grid with milestones have in common (dissertation chapter 6).
//!
//! Agrees bit for bit with the dissertation's public code from the same state, actions and lost items. One agent sees a
//! window around itself, turned so that it faces up, and counts what it carries. [`Spec::milestones`] are what can be
//! reached on the way to the task, the last of them; [`Environment::affordances`] says which of them can be next.
//!
//! [`Spec::milestones`]: crate::Spec::milestones
//! [`Environment::affordances`]: crate::Environment::affordances

pub(crate) mod board;
mod episode;
mod game;
mod rules;
mod seam;
mod set;
mod simulator;
mod spec;
mod states;
mod window;
mod world;

pub use game::{Effect, Game};
pub use rules::Rules;
pub(crate) use seam::entry;
pub use set::MilestoneSet;
pub use simulator::Milestones;
pub use window::{RADIUS, WINDOW, window};
pub use world::World;
pub(crate) use world::{EMPTY, ITEMS, WALL};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
