//! A deployed team in a built-in world, and what there is to see of it.
//!
//! The command line plays and shows teams by this; the program of `sortie view --live` pages does the same in a browser.
//! So both have the same world, the same roles and the same search, and give the same bits.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

extern crate alloc;

mod cast;
mod crafting;
mod episodes;
mod error;
mod golden;
mod golden_hash;
pub mod gridworld;
pub mod group_matching;
mod memory;
pub mod milestones;
mod mind;
mod names;
mod notes;
mod options;
pub mod particle;
mod player;
mod rules;
pub mod save_the_city;
mod search;
mod show;
mod stage;
pub mod tally;
#[cfg(test)]
mod tests;
mod thoughts;
mod treasure_rooms;
mod utilities;
pub mod world;

pub use cast::{AllocatorCast, Cast};
pub use error::StageError;
pub use golden::GoldenObservation;
pub use golden_hash::golden_hash;
pub use memory::Memory;
pub use names::lettered;
pub use options::OptionSettings;
pub use player::{News, Opening, Player, memory};
pub use rules::{FrameRelation, RuleAllocator};
pub use search::{LearnedAllocator, Search, SearchSizes, TeamValuePlan};
pub use show::{Glance, Show, Shown};
pub use stage::{Moment, Stage};
pub use thoughts::{Attention, Head, Pursued, Thought, rounded};
pub use utilities::{UtilityHash, hash_of};
