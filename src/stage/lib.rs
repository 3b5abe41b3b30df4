//! A deployed team in a built-in world, and what there is to see of it.
//!
//! The command line plays and shows teams by this; the program of `sortie view --live` pages does the same in a browser.
//! So both have the same world, the same roles and the same search, and give the same bits.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

extern crate alloc;

mod allocation;
mod cast;
mod error;
mod memory;
mod mind;
mod player;
mod show;
mod stage;
pub mod tally;
mod team_values;
mod thoughts;
mod utilities;
pub mod world;

pub use allocation::{
    FrameRelation, LearnedAllocator, RuleAllocator, Search, SearchSizes, TeamValuePlan,
};
pub use cast::{AllocatorCast, Cast, GoldenObservation, OptionSettings};
pub use error::StageError;
pub use memory::Memory;
pub use player::{News, Opening, Player, memory};
pub use show::{AgentFacts, Event, Facts, Glance, Shown, State, Step, result};
pub use stage::{Moment, Stage};
pub use team_values::TeamValues;
pub use thoughts::{Attention, Head, Pursued, Thought, rounded};
pub use utilities::{UtilityHash, golden_hash, hash_of};

#[cfg(test)]
mod tests;
