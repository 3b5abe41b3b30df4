//! Group Matching: agents on a ring of cells gather, each with its group (dissertation chapter 5).
//!
//! Agrees bit for bit with the dissertation's public code from the same state and executed actions.
//! There are no entities but the agents, and everybody observes everybody.

mod bytes;
mod error;
mod features;
#[cfg(feature = "std")]
pub mod golden;
mod groups;
mod metrics;
mod parameters;
mod reset;
mod ring;
mod rules;
mod seam;
mod simulator;
mod spec;
mod walk;

pub use bytes::{ring_of, state_bytes};
pub use error::ParametersError;
pub use features::{columns, feature_names, write_row};
pub use metrics::EpisodeMetrics;
pub use parameters::{MAX_AGENTS, MAX_CELLS, MAX_GROUPS, Parameters, SET_NAMES};
pub use ring::Ring;
pub use rules::{ACTION_NAMES, ACTIONS, LEFT, RIGHT, STAY};
pub use seam::ENTRY;
pub use simulator::GroupMatching;
pub use spec::sizes;
pub use walk::walk;

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
