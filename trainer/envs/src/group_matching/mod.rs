//! Group Matching: agents on a ring of cells gather, each with its group (dissertation chapter 5).
//!
//! Agrees bit for bit with the dissertation's public code from the same state and executed actions.
//! There are no entities but the agents, and everybody observes everybody.

mod environment;
#[cfg(feature = "std")]
pub mod golden;
mod parameters;
mod ring;

use alloc::boxed::Box;
use alloc::string::String;

use crate::entry::Entry;
use environment::NAME;

pub use environment::{EpisodeMetrics, GroupMatching, columns, feature_names, sizes, write_row};
pub use parameters::{MAX_AGENTS, MAX_CELLS, MAX_GROUPS, Parameters, ParametersError, SET_NAMES};
pub use ring::{ACTION_NAMES, ACTIONS, LEFT, RIGHT, Ring, STAY, state_bytes, walk};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: NAME,
    about: "Agents on a ring of cells gather, each with its group (dissertation chapter 5)",
    version: VERSION,
    sets: || SET_NAMES.map(String::from).to_vec(),
    open: |choice| Ok(Box::new(environment::open(choice)?)),
    rules: &[],
    reader: None,
    #[cfg(feature = "std")]
    recordings: Some(golden::RECORDINGS),
};
