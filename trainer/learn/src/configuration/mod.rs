//! Configurations as files: read, checked key by key, changed, and explained.

mod define;
mod explained;
mod key;
mod keys;

use serde::Serialize;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

#[doc(hidden)]
pub use define::{count, joined};
pub use explained::explained;
pub(crate) use key::find;
use key::nearest_path;
pub use key::{Key, Range, Section, paths};
pub use keys::{
    EXPLORATION, ExplorationConfig, INSTANCES, OPTIMISER, OptimiserConfig, RUN, RunConfig, SHARE,
    STEPS, WHERE, WIDEST, exploration,
};

use crate::error::LearnError;

/// The keys of `train.toml` that are about the run, not its configuration.
pub const RUN_KEYS: [&str; 4] = ["method", "version", "seed", "threads"];

/// Refuses a table as [`check_table`] does, by the line of the file's text that is wrong.
///
/// # Errors
/// A key is unknown, or its value outside its limits.
pub fn check_file(text: &str, table: &Table, sections: &[Section]) -> Result<(), LearnError> {
    check_table("", table, sections).map_err(|error| match error {
        LearnError::Value { key, reason, .. } => {
            LearnError::Value { line: line_of(text, &key), key, reason }
        }
        error => error,
    })
}

/// The table of a file's text.
pub fn parsed(text: &str) -> Result<Table, LearnError> {
    text.parse().map_err(|error: toml::de::Error| {
        let line = error.span().map_or(0, |span| line_at(text, span.start));
        let written = text.lines().nth(line.saturating_sub(1)).unwrap_or_default().trim();
        let reason = error.message().replace('\n', ", ");
        LearnError::Syntax { line, reason: format!("`{written}`: {reason}") }
    })
}

/// A configuration with its values as they are written.
pub fn table_of(config: &impl Serialize) -> Result<Table, LearnError> {
    parsed(&to_toml(config)?)
}

/// Refuses a table with an unknown key, or a value outside the limits of its key; `within` is where it stands.
pub fn check_table(within: &str, table: &Table, sections: &[Section]) -> Result<(), LearnError> {
    for (name, value) in table {
        let path = if within.is_empty() { name.clone() } else { format!("{within}.{name}") };
        match (value, find(sections, &path)) {
            (Value::Table(_), None) if is_open(sections, &path) => {}
            (Value::Table(inner), None) => check_table(&path, inner, sections)?,
            (_, None) => return Err(unknown(&path, sections)),
            (value, Some(key)) => check_value(path, key, value)?,
        }
    }
    Ok(())
}

fn check_value(path: String, key: &Key, value: &Value) -> Result<(), LearnError> {
    if key.range.holds(value) {
        return Ok(());
    }
    Err(outside(path, key, value.to_string()))
}

fn outside(path: String, key: &Key, value: String) -> LearnError {
    let unit = if key.unit.is_empty() { String::new() } else { format!(" ({})", key.unit) };
    let reason = format!("is {value}, must be {}{unit}", key.range);
    LearnError::Value { line: None, key: path, reason }
}

fn unknown(path: &str, sections: &[Section]) -> LearnError {
    let meant = nearest_path(sections, path);
    let hint = meant.map_or(String::new(), |key| format!("; did you mean `{key}`?"));
    LearnError::Value { line: None, key: path.to_owned(), reason: format!("is no such key{hint}") }
}

/// The line of a file that gives a key its value.
fn line_of(text: &str, path: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut names = path.split('.').peekable();
    loop {
        let name = names.next()?;
        let (key, value) = table.iter().find(|(key, _)| key.get_ref() == name)?;
        if names.peek().is_none() {
            return Some(line_at(text, key.span().start));
        }
        let DeValue::Table(inner) = value.get_ref() else {
            return Some(line_at(text, key.span().start));
        };
        table = inner;
    }
}

fn line_at(text: &str, place: usize) -> usize {
    1 + text.bytes().take(place).filter(|byte| *byte == b'\n').count()
}

/// Replaces the values of a table by those of another, of inner tables value by value: a section that
/// names one key keeps the others as this configuration has them, not as the section's own type has.
pub fn overlay(table: &mut Table, by: Table) {
    for (key, new) in by {
        match (table.get_mut(&key), new) {
            (Some(Value::Table(old)), Value::Table(new)) => overlay(old, new),
            (_, new) => drop(table.insert(key, new)),
        }
    }
}

/// The configuration as a file that a person can read.
pub fn to_toml(config: &impl Serialize) -> Result<String, LearnError> {
    toml::to_string(config).map_err(|error| LearnError::Config(error.to_string()))
}

/// A table with the value of one of its keys replaced.
pub fn assigned(
    sections: &[Section],
    mut table: Table,
    assignment: &str,
) -> Result<Table, LearnError> {
    let bad = |why: &str| LearnError::Config(format!("`{assignment}`: {why}"));
    let (path, text) = assignment.split_once('=').ok_or_else(|| bad("not `key=value`"))?;
    let (path, text) = (path.trim(), text.trim());
    let (parents, name) = path.rsplit_once('.').unwrap_or(("", path));
    let value = if is_open(sections, parents) {
        value_of(text).unwrap_or_else(|| Value::String(text.to_owned()))
    } else {
        let key = find(sections, path).ok_or_else(|| unknown(path, sections))?;
        let value = parsed_as(key.range, text)
            .ok_or_else(|| outside(path.to_owned(), key, format!("`{text}`")))?;
        check_value(path.to_owned(), key, &value)?;
        value
    };
    let mut place = &mut table;
    for parent in parents.split('.').filter(|parent| !parent.is_empty()) {
        let inner = place.get_mut(parent).and_then(Value::as_table_mut);
        place = inner.ok_or_else(|| unknown(path, sections))?;
    }
    place.insert(name.to_owned(), value);
    Ok(table)
}

/// Whether a section takes any key: what they are is up to somebody else.
fn is_open(sections: &[Section], name: &str) -> bool {
    sections.iter().any(|section| section.name == name && section.keys.is_empty())
}

/// A text as a value of a file.
fn value_of(text: &str) -> Option<Value> {
    format!("value = {text}").parse::<Table>().ok()?.remove("value")
}

/// Refuses a configuration that does not hold, with what it must be.
pub fn require(holds: bool, what: &str) -> Result<(), LearnError> {
    if holds { Ok(()) } else { Err(LearnError::Config(what.to_owned())) }
}

/// Reads `text` as a value of a key.
fn parsed_as(range: Range, text: &str) -> Option<Value> {
    Some(match range {
        Range::Whole(..) => Value::Integer(text.replace('_', "").parse().ok()?),
        Range::Number(..) | Range::Positive(_) => Value::Float(text.replace('_', "").parse().ok()?),
        Range::Truth => Value::Boolean(text.parse().ok()?),
        Range::Numbers(..) => value_of(text)?,
        Range::OneOf(_) | Range::Said(..) | Range::Text => Value::String(text.to_owned()),
    })
}
