//! Configurations as files: read, checked, and changed value by value.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::LearnError;
use crate::run::KEYS;

/// What can be kept in a file.
pub(crate) trait Kept: Default + Serialize + DeserializeOwned {}
impl<C: Default + Serialize + DeserializeOwned> Kept for C {}

/// Reads a configuration; what is missing keeps its default.
///
/// A run's `train.toml` will do: its lines about the run itself are passed over.
pub(crate) fn from_toml<C: Kept>(text: &str) -> Result<C, LearnError> {
    let bad = |error: toml::de::Error| LearnError::Config(error.message().to_owned());
    let mut table: toml::Table = text.parse().map_err(bad)?;
    for key in KEYS {
        table.remove(key);
    }
    from_table(table)
}

/// Reads a configuration that was part of a file; what is missing keeps its default.
pub(crate) fn from_table<C: Kept>(table: toml::Table) -> Result<C, LearnError> {
    let default = toml::Table::try_from(C::default());
    let mut whole = default.map_err(|error| LearnError::Config(error.to_string()))?;
    overlay(&mut whole, table);
    whole
        .try_into()
        .map_err(|error: toml::de::Error| LearnError::Config(error.message().to_owned()))
}

/// Replaces the values of a table by those of another, of inner tables value by value: a section that
/// names one key keeps the others as this configuration has them, not as the section's own type has.
fn overlay(table: &mut toml::Table, by: toml::Table) {
    for (key, new) in by {
        match (table.get_mut(&key), new) {
            (Some(toml::Value::Table(old)), toml::Value::Table(new)) => overlay(old, new),
            (_, new) => drop(table.insert(key, new)),
        }
    }
}

/// The configuration as a file that a person can read.
pub(crate) fn to_toml(config: &impl Serialize) -> Result<String, LearnError> {
    toml::to_string(config).map_err(|error| LearnError::Config(error.to_string()))
}

/// A configuration with one value replaced, named as in `replay.batch=256`.
pub(crate) fn replaced<C: Serialize + DeserializeOwned>(
    config: &C,
    assignment: &str,
) -> Result<C, LearnError> {
    let bad = |why: &str| LearnError::Config(format!("`{assignment}`: {why}"));
    let (key, value) = assignment.split_once('=').ok_or_else(|| bad("not `key=value`"))?;
    let mut table = toml::Table::try_from(config).map_err(|e| bad(&e.to_string()))?;
    let (parents, name) = key.trim().rsplit_once('.').ok_or_else(|| bad("no such key"))?;
    let mut place = &mut table;
    for parent in parents.split('.') {
        place = place
            .get_mut(parent)
            .and_then(toml::Value::as_table_mut)
            .ok_or_else(|| bad("no such key"))?;
    }
    let old = place.get(name).ok_or_else(|| bad("no such key"))?;
    let new = parse_like(old, value.trim()).ok_or_else(|| bad("not a value of that kind"))?;
    place.insert(name.to_owned(), new);
    table.try_into().map_err(|e: toml::de::Error| bad(e.message()))
}

/// Refuses a configuration that does not hold, with what it must be.
pub(crate) fn require(holds: bool, what: &str) -> Result<(), LearnError> {
    if holds { Ok(()) } else { Err(LearnError::Config(what.to_owned())) }
}

/// Reads `text` as a value of the same kind as `old`.
fn parse_like(old: &toml::Value, text: &str) -> Option<toml::Value> {
    use toml::Value;
    Some(match old {
        Value::String(_) => Value::String(text.to_owned()),
        Value::Integer(_) => Value::Integer(text.replace('_', "").parse().ok()?),
        Value::Float(_) => Value::Float(text.parse().ok()?),
        Value::Boolean(_) => Value::Boolean(text.parse().ok()?),
        _ => toml::from_str::<toml::Table>(&format!("value = {text}")).ok()?.remove("value")?,
    })
}
