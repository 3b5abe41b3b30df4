//! Recorded episodes, schema `sortie-golden/save-the-city/1`: written, read, and replayed exactly.
//!
//! A file holds the constants, the first state, the actions and the collision losers, which
//! determine an episode, and beside them everything that follows, which a replay compares bit for
//! bit. Masks in the files are inverted: 1 means masked, absent or closed.

mod events;
mod frames;
mod playback;
mod record;
mod replay;

pub use crate::recorded::Labels;
use crate::recorded::Recordings;
pub use playback::Playback;
pub use record::Recorder;
pub use replay::replay;

/// The schema that files must name.
pub const SCHEMA: &str = "sortie-golden/save-the-city/1";

/// How they are found.
pub(super) const RECORDINGS: Recordings =
    Recordings { schema: SCHEMA, replay, record: Some(record::start) };
