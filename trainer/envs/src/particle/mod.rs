//! The particle world: discs with inertia on a plane, in the three scenarios of dissertation chapter 3.
//!
//! Agrees with the world that MAAC's public code runs on; others of the name differ
//! (docs/reference/environments.md). Every agent sees one vector of its own, and earns rewards of its own: the team's
//! is their mean, so that the return of an episode is the mean of theirs. No scenario comes to an end of its own: time
//! runs out.

mod bytes;
mod columns;
mod drawing;
mod navigation;
mod physics;
mod picture;
mod plane;
mod rover_tower;
mod scenario;
mod seam;
mod simulator;
mod spec;
mod states;
mod steering;
mod treasure;

pub use bytes::Reader;
pub use columns::Row;
pub use drawing::picture_of;
pub use navigation::{Navigated, Navigation};
pub use physics::{ACTIONS, Body, MOVES, Mover};
pub use picture::{Disc, Drawn, Picture, Thing};
pub use plane::Point;
pub use rover_tower::{Roved, RoverTower, Tower};
pub use scenario::Scenario;
pub use seam::{ENTRY, SET_NAMES};
pub use simulator::Particle;
pub use treasure::{DeadTreasures, Hand, Hoard, Stage, Treasure, TreasureCollection};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
