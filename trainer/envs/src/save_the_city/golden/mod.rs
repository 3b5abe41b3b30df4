//! Recorded episodes, schema `sortie-golden/save-the-city/1`: written, read, and replayed exactly.
//!
//! A file holds the constants, the first state, the actions and the collision losers, which
//! determine an episode, and beside them everything that follows, which a replay compares bit for
//! bit. Masks in the files are inverted: 1 means masked, absent or closed.

mod error;
mod events;
mod fields;
mod frames;
mod playback;
mod record;
mod replay;

pub use error::GoldenError;
pub use playback::Playback;
pub use record::{Labels, Recorder};
pub use replay::{Mismatch, Replay, replay, replay_file};

/// The schema that files must name.
pub const SCHEMA: &str = "sortie-golden/save-the-city/1";
