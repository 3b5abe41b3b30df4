//! Recorded episodes of any environment, replayed exactly.

use std::path::Path;

use crate::recorded::Field;
pub use crate::recorded::{GoldenError, Mismatch, Replay};
use crate::{group_matching, save_the_city};

/// Replays an episode given as text under the name of its file.
type ReplayText = fn(&str, &str) -> Result<Replay, GoldenError>;

/// The schemas that a file may name, and who replays it.
const SCHEMAS: [(&str, ReplayText); 2] = [
    (save_the_city::golden::SCHEMA, save_the_city::golden::replay),
    (group_matching::golden::SCHEMA, group_matching::golden::replay),
];

/// Replays the episode in a file.
pub fn replay_file(path: &Path) -> Result<Replay, GoldenError> {
    let text = std::fs::read_to_string(path).map_err(GoldenError::Read)?;
    replay(&path.display().to_string(), &text)
}

/// Replays an episode given as text; `file` names it in the mismatches.
///
/// An action that is not available ends the replay and counts as a mismatch.
pub fn replay(file: &str, text: &str) -> Result<Replay, GoldenError> {
    let value = serde_json::from_str(text).map_err(GoldenError::Json)?;
    let schema = Field::root(&value).get("schema")?;
    let named = schema.text()?;
    let known = SCHEMAS.iter().find(|(known, _)| *known == named);
    let names = SCHEMAS.map(|(known, _)| format!("`{known}`"));
    let (_, replay) =
        known.ok_or_else(|| schema.refuse(format!("is not {}", names.join(" or "))))?;
    replay(file, text)
}
