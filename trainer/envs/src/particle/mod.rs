//! The particle world: discs with inertia on a plane, in the three scenarios of dissertation chapter 3.
//!
//! Agrees with the world that MAAC's public code runs on; others of the name differ
//! (docs/reference/environments.md). Every agent sees one vector of its own, and earns rewards of its own: the team's
//! is their mean, so that the return of an episode is the mean of theirs. No scenario comes to an end of its own: time
//! runs out.

mod environment;
mod navigation;
mod physics;
mod rover_tower;
mod scenario;
mod treasure;

pub use crate::bytes::Reader;
pub use environment::{ENTRY, Particle, SET_NAMES};
pub use navigation::{Navigated, Navigation};
pub use physics::{ACTIONS, Body, MOVES, Mover, Point};
pub use rover_tower::{Roved, RoverTower, Tower};
pub use scenario::{Row, Scenario, Spot};
pub use treasure::{DeadTreasures, Hand, Hoard, Stage, Treasure, TreasureCollection};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
