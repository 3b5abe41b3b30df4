//! Configurations as files that explain every key.

use toml::{Table, Value};

use super::key::{Key, Section};
use crate::error::LearnError;

/// The values of these sections as a file with comments.
pub fn explained(sections: &[Section], table: &Table) -> Result<String, LearnError> {
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
            text += &toml::to_string(part(table, section)?).map_err(unwritable)?;
        }
        for key in section.keys {
            let Key { name, about, .. } = key;
            let value = value(table, section, key)?;
            text += &format!("# {about}\n#   {}\n{name} = {value}\n", limits(key));
        }
    }
    Ok(text)
}

/// Range and unit of a key.
fn limits(key: &Key) -> String {
    let Key { unit, range, .. } = key;
    if unit.is_empty() { range.to_string() } else { format!("{range} ({unit})") }
}

fn value<'a>(table: &'a Table, section: &Section, key: &Key) -> Result<&'a Value, LearnError> {
    let missing = || LearnError::Config(format!("`{}.{}` has no value", section.name, key.name));
    part(table, section)?.get(key.name).ok_or_else(missing)
}

/// The values of a section.
fn part<'a>(table: &'a Table, section: &Section) -> Result<&'a Table, LearnError> {
    let mut parents = section.name.split('.').filter(|parent| !parent.is_empty());
    let inner = parents.try_fold(table, |table, parent| table.get(parent)?.as_table());
    inner.ok_or_else(|| LearnError::Config(format!("there is no section `{}`", section.name)))
}

fn unwritable(error: toml::ser::Error) -> LearnError {
    LearnError::Config(error.to_string())
}
