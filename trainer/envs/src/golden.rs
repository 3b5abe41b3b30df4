//! Recorded episodes of any environment, replayed exactly.

use std::path::Path;

use crate::entry::Entry;
use crate::recorded::Field;
use crate::registry::ENVIRONMENTS;

pub use crate::recorded::{
    GoldenError, Labels, Mismatch, Record, Recordings, Replay, StartRecording,
};

/// Replays the episode in a file.
pub fn replay_file(path: &Path) -> Result<Replay, GoldenError> {
    let text = std::fs::read_to_string(path).map_err(GoldenError::Read)?;
    replay(&path.display().to_string(), &text)
}

/// Replays an episode given as text; `file` names it in the mismatches.
///
/// An action that is not available ends the replay and counts as a mismatch.
pub fn replay(file: &str, text: &str) -> Result<Replay, GoldenError> {
    let (_, recordings) = recorded(text)?;
    (recordings.replay)(file, text)
}

/// The environment of an episode given as text.
pub fn environment(text: &str) -> Result<&'static Entry, GoldenError> {
    recorded(text).map(|(entry, _)| entry)
}

/// The environment whose schema the text names.
fn recorded(text: &str) -> Result<(&'static Entry, Recordings), GoldenError> {
    let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
    let schema = Field::root(&value).get("schema")?;
    let named = schema.text()?;
    let known: Vec<_> =
        ENVIRONMENTS.iter().filter_map(|entry| Some((entry, entry.recordings?))).collect();
    if let Some(found) = known.iter().find(|(_, recordings)| recordings.schema == named) {
        return Ok(*found);
    }
    let names: Vec<_> =
        known.iter().map(|(_, recordings)| format!("`{}`", recordings.schema)).collect();
    Err(schema.refuse(format!("is not {}", names.join(" or "))))
}
