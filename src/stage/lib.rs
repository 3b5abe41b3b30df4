//! A deployed team in a built-in world, and what there is to see of it.
//!
//! The command line plays and shows teams by this; the program of `sortie view --live` pages does the same in a browser.
//! So both have the same world, the same roles and the same search, and give the same bits.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod cast;
mod error;
mod memory;
mod notes;
mod rules;
pub mod save_the_city;
mod search;
mod stage;
pub mod tally;
mod thoughts;
mod utilities;
pub mod world;

pub use cast::{Cast, GoldenObservation};
pub use error::StageError;
pub use memory::Memory;
pub use rules::{FrameRelation, RuleAllocator};
pub use search::{LearnedAllocator, Search, SearchSizes, TeamValuePlan};
pub use stage::{Moment, Stage};
pub use thoughts::{Attention, Thought, rounded};
pub use utilities::{UtilityHash, hash_of};
