//! Configurations as files: read, checked key by key, changed, and explained.

mod define;
mod key;
mod keys;

use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

#[doc(hidden)]
pub use define::{count, joined};
pub(crate) use key::find;
use key::nearest_path;
pub use key::{Key, Range, Section, paths};
pub use keys::{
    EXPLORATION, ExplorationConfig, INSTANCES, OPTIMISER, OptimiserConfig, RUN, RunConfig, SHARE,
    STEPS, WHERE, WIDEST, exploration,
};

use crate::error::{LearnError, Result};

/// The keys of `train.toml` that are about the run, not its configuration.
pub const RUN_KEYS: [&str; 4] = ["method", "version", "seed", "threads"];

/// Refuses a table as [`check_table`] does, by the line of the file's text that is wrong.
pub(crate) fn check_file(text: &str, table: &Table, sections: &[Section]) -> Result<()> {
    check_table("", table, sections).map_err(|error| match error {
        LearnError::Value { key, reason, .. } => {
            LearnError::Value { line: line_of(text, &key), key, reason }
        }
        error => error,
    })
}

/// The table of a file's text.
pub fn parsed(text: &str) -> Result<Table> {
    text.parse().map_err(|error: toml::de::Error| {
        let line = error.span().map_or(0, |span| line_at(text, span.start));
        let written = text.lines().nth(line.saturating_sub(1)).unwrap_or_default().trim();
        let reason = error.message().replace('\n', ", ");
        LearnError::Syntax { line, reason: format!("`{written}`: {reason}") }
    })
}

/// A configuration with its values as they are written.
pub fn table_of(config: &impl Serialize) -> Result<Table> {
    parsed(&to_toml(config)?)
}

/// What a file has, as a type that reads it.
pub(crate) fn as_type<T: DeserializeOwned>(value: Value) -> Result<T> {
    value.try_into().map_err(|error: toml::de::Error| LearnError::Config(error.message().into()))
}

/// Refuses a table with an unknown key, or a value outside the limits of its key; `within` is where it stands.
pub fn check_table(within: &str, table: &Table, sections: &[Section]) -> Result<()> {
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

fn check_value(path: String, key: &Key, value: &Value) -> Result<()> {
    if key.range.holds(value) {
        return Ok(());
    }
    Err(outside(path, key, value.to_string()))
}

fn outside(path: String, key: &Key, value: String) -> LearnError {
    let reason = format!("is {value}, must be {}", key.limits());
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
        match value.get_ref() {
            DeValue::Table(inner) if names.peek().is_some() => table = inner,
            _ => return Some(line_at(text, key.span().start)),
        }
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
pub fn to_toml(config: &impl Serialize) -> Result<String> {
    toml::to_string(config).map_err(|error| LearnError::Config(error.to_string()))
}

/// A table with the value of one of its keys replaced.
pub fn assigned(sections: &[Section], mut table: Table, assignment: &str) -> Result<Table> {
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

/// The values of these sections as a file with comments.
pub fn explained(sections: &[Section], table: &Table) -> Result<String> {
    let mut text = String::new();
    for section in sections {
        if !text.is_empty() {
            text.push('\n');
        }
        text += &format!("# {}\n", section.about);
        if !section.name.is_empty() {
            text += &format!("[{}]\n", section.name);
        }
        if section.keys.is_empty() {
            text += &to_toml(part(table, section)?)?;
        }
        for key in section.keys {
            let Key { name, about, .. } = key;
            let missing = || LearnError::Config(format!("`{}.{name}` has no value", section.name));
            let value = part(table, section)?.get(*name).ok_or_else(missing)?;
            text += &format!("# {about}\n#   {}\n{name} = {value}\n", key.limits());
        }
    }
    Ok(text)
}

/// The values of a section.
fn part<'a>(table: &'a Table, section: &Section) -> Result<&'a Table> {
    let mut parents = section.name.split('.').filter(|parent| !parent.is_empty());
    let inner = parents.try_fold(table, |table, parent| table.get(parent)?.as_table());
    inner.ok_or_else(|| LearnError::Config(format!("there is no section `{}`", section.name)))
}

/// Refuses a configuration that does not hold, with what it must be.
pub fn require(holds: bool, what: &str) -> Result<()> {
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
