//! What environments need to read recorded episodes and to compare them with what a replay gives.

mod comparison;
mod error;
mod fields;

pub(crate) use comparison::Comparison;
pub use comparison::{Mismatch, Replay};
pub use error::GoldenError;
pub(crate) use fields::Field;

/// How episodes of an environment are recorded.
#[derive(Clone, Copy, Debug)]
pub struct Recordings {
    /// The schema that their files name.
    pub schema: &'static str,
    /// Replays an episode given as text under the name of its file.
    pub replay: fn(&str, &str) -> Result<Replay, GoldenError>,
}
