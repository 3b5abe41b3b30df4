//! What environments need to read recorded episodes and to compare them with what a replay gives.

mod comparison;
mod error;
mod fields;

pub(crate) use comparison::Comparison;
pub use comparison::{Mismatch, Replay};
pub use error::GoldenError;
pub(crate) use fields::Field;

use std::fmt;

use crate::environment::{Environment, Step};

/// What a recorded episode is called; for people, nothing depends on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Labels {
    /// Name of the episode.
    pub name: String,
    /// What the actions come from.
    pub policy: String,
    /// Seed of the run.
    pub seed: u64,
}

/// Writes one episode of one instance down.
///
/// Start it right after a reset, tell it every step, and take the text when the episode is done and
/// the instance not yet reset. It is told of the environment that it was started in, and of no other.
pub trait Record {
    /// Adds the step that was just taken.
    fn step(&mut self, environment: &dyn Environment, actions: &[u16], step: &Step);

    /// The episode as text.
    fn finish(self: Box<Self>, environment: &dyn Environment) -> String;
}

/// How episodes of an environment are recorded.
#[derive(Clone, Copy)]
pub struct Recordings {
    /// The schema that their files name.
    pub schema: &'static str,
    /// Replays an episode given as text under the name of its file.
    pub replay: fn(&str, &str) -> Result<Replay, GoldenError>,
    /// Starts to record the episode of an instance; none where recordings come from elsewhere.
    pub record: Option<StartRecording>,
}

/// Starts to record the episode of an instance; none in another environment.
pub type StartRecording = fn(&dyn Environment, usize, Labels) -> Option<Box<dyn Record>>;

impl fmt::Debug for Recordings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recordings").field("schema", &self.schema).finish_non_exhaustive()
    }
}
