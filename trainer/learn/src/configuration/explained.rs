//! Configurations with an explanation of every key: as a file, and as a page of the documentation.

use serde::Serialize;
use toml::{Table, Value};

use super::key::{Key, Section};
use super::keys::{FAST, PAPER};
use super::{Kept, table_of};
use crate::error::LearnError;
use crate::methods::{alma, paper};

/// A configuration as a file with comments.
pub(crate) fn explained<C: Kept>(config: &C) -> Result<String, LearnError> {
    explained_by(C::SECTIONS, &table_of(config)?)
}

/// The values of these sections as a file with comments.
pub(crate) fn explained_by(sections: &[Section], table: &Table) -> Result<String, LearnError> {
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

/// The page `docs/configuration.md`.
pub fn reference() -> Result<String, LearnError> {
    let mut page = String::from(HEAD);
    page += &tables("Preset `fast`", FAST, &alma::Config::default())?;
    page += &tables("Preset `paper`", PAPER, &paper::Config::default())?;
    Ok(page)
}

const HEAD: &str = "\
# The configuration, key by key

`sortie train METHOD --print-config` prints the configuration that a command would learn by, with all of this as comments; it
takes `--preset`, `--config`, `--set` and the other flags. What it prints is a file for `--config`, which may leave out what it
does not change. `--set replay.batch=256` changes one value. A value outside its range, or a key that does not exist, is
refused with exit code 2, by key, value and range, in files also by line. `train.toml` in a run's folder holds the values
that the run learns by; `sortie train METHOD --resume DIR --steps N` changes `run.steps` and nothing else.

In the preset `fast`, runs of less than 600,000 steps shrink `exploration.steps`, `allocator.learns_from` and
`allocator.decides_from` in proportion, unless they are set.

This page is written by the program; a test compares them.
";

/// The keys of these sections as tables, with their defaults.
pub(crate) fn tables(
    title: &str,
    sections: &[Section],
    config: &impl Serialize,
) -> Result<String, LearnError> {
    let table = table_of(config)?;
    let mut text = format!("\n## {title}\n");
    for section in sections {
        let heading = if section.name.is_empty() { "At the top" } else { section.name };
        text += &format!("\n### {heading}\n\n{}\n", section.about);
        if section.keys.is_empty() {
            continue;
        }
        text += "\n| key | default | range | what |\n| --- | --- | --- | --- |\n";
        for key in section.keys {
            let Key { name, about, .. } = key;
            let value = value(&table, section, key)?;
            text += &format!("| `{name}` | `{value}` | {} | {about} |\n", limits(key));
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
