//! What two configurations have in common, key by key.

use std::collections::{BTreeMap, BTreeSet};

use toml::{Table, Value};

use super::description::Configuration;
use crate::configuration;
use crate::error::LearnError;

/// A key that two configurations have other values for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The key, as in `run.steps`.
    pub key: String,
    /// Its value in the one.
    pub ours: String,
    /// Its value in the other.
    pub theirs: String,
}

impl Difference {
    /// The first key whose value is another in `theirs`: `run.steps`, on which others may depend, then in the
    /// order of the alphabet.
    pub fn between<C: Configuration>(ours: &C, theirs: &C) -> Result<Option<Self>, LearnError> {
        let (ours, theirs) = (values(&ours.to_toml()?)?, values(&theirs.to_toml()?)?);
        let keys: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
        let value = |values: &BTreeMap<String, Value>, key| match values.get(key) {
            Some(value) => value.to_string(),
            None => "not there".to_owned(),
        };
        let steps = "run.steps".to_owned();
        let mut keys = [&steps].into_iter().chain(keys);
        Ok(keys.find(|key| ours.get(*key) != theirs.get(*key)).map(|key| Self {
            key: key.clone(),
            ours: value(&ours, key),
            theirs: value(&theirs, key),
        }))
    }
}

/// The keys that a file has a value for.
pub fn keys_in(text: &str) -> Result<Vec<String>, LearnError> {
    Ok(values(text)?.into_keys().collect())
}

/// All values of a file by their keys.
fn values(text: &str) -> Result<BTreeMap<String, Value>, LearnError> {
    let mut values = BTreeMap::new();
    flatten("", configuration::parsed(text)?, &mut values);
    Ok(values)
}

fn flatten(name: &str, table: Table, to: &mut BTreeMap<String, Value>) {
    for (key, value) in table {
        let key = if name.is_empty() { key } else { format!("{name}.{key}") };
        match value {
            Value::Table(inner) => flatten(&key, inner, to),
            value => drop(to.insert(key, value)),
        }
    }
}
