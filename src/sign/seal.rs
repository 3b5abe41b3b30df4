//! Texts that end with a checksum over what stands before it.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use sortie_bundle::{files, hex, sha256};

use crate::error::SignError;

/// The version of all files of this crate.
pub(crate) const FORMAT: i64 = 1;
/// The largest file of this crate that is read.
const MOST_BYTES: u64 = 256 << 10;
/// In a comment: behind a table it would be one of its fields.
const CHECK: &str = "# check = \"";

/// A text of these fields. What `comment` says to people is covered as well.
pub(crate) fn sealed(comment: &str, fields: &impl Serialize) -> String {
    let fields = toml::to_string(fields).expect("texts, and lists of tables of texts");
    let text = format!("# {comment}\nformat = {FORMAT}\n{fields}");
    with_checksum(&text)
}

/// A text with its checksum below: for tests that forge.
#[doc(hidden)]
pub fn with_checksum(text: &str) -> String {
    format!("{text}{CHECK}{}\"\n", check(text))
}

fn check(text: &str) -> String {
    hex(&sha256(text.as_bytes())[..8])
}

/// The fields of such a text.
pub(crate) fn unsealed<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, SignError> {
    let unreadable = |error: toml::de::Error| SignError::damaged(path, error.message());
    let mut table: toml::Table = text.parse().map_err(unreadable)?;
    // The version first: a newer file may be sealed in another way.
    match table.remove("format").and_then(|format| format.as_integer()) {
        Some(FORMAT) => {}
        Some(got) if got > FORMAT => return Err(SignError::Version { path: path.to_owned(), got }),
        _ => return Err(SignError::damaged(path, "its format is missing")),
    }
    let sealed = text.rsplit_once(CHECK);
    let is_whole = sealed.is_some_and(|(text, rest)| rest == format!("{}\"\n", check(text)));
    if !is_whole {
        return Err(SignError::damaged(path, "its checksum does not match"));
    }
    table.try_into().map_err(unreadable)
}

/// Reads a file of this crate.
pub(crate) fn read_text(path: &Path) -> Result<String, SignError> {
    files::read_text(path, MOST_BYTES).map_err(|error| SignError::io(path, error))
}
