//! Skirmishes: teams of units fight in the manner of StarCraft II, in the open or around a base that they defend against
//! several armies (dissertation chapters 5 and 7).
//!
//! Numbers of units are those of the game's first rule book, sixteen ticks to a second and eight ticks to a step; no
//! behaviour was compared with the game, so that shares of battles won compare with each other, not with those of StarCraft.
//! Enemies advance and fight whom they meet; agents do what they are told and nothing by themselves.

mod armies;
mod battle;
mod bytes;
mod encounter;
mod environment;
mod fight;
mod frames;
mod moving;
mod observation;
mod orders;
mod picture;
mod relations;
mod rules;
mod scenarios;
mod units;

pub use environment::{ENTRY, Skirmish};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
#[cfg(test)]
mod tests;
