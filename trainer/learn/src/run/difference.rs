//! What two configurations have in common, key by key.

use std::collections::BTreeMap;

use toml::{Table, Value};

use super::Setup;
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
    /// The keys whose values are others in `theirs`: `run.steps` first, on which others may depend, then in the order of
    /// the alphabet.
    pub fn between(ours: &Setup, theirs: &Setup) -> Result<Vec<Self>, LearnError> {
        let (ours, theirs) = (values(&ours.to_toml()?)?, values(&theirs.to_toml()?)?);
        let mut keys: Vec<&String> = ours.keys().chain(theirs.keys()).collect();
        keys.sort_by_key(|key| (*key != "run.steps", *key));
        keys.dedup();
        let value = |values: &BTreeMap<String, Value>, key: &str| match values.get(key) {
            Some(value) => value.to_string(),
            None => "not there".to_owned(),
        };
        let differ = |key: &&String| ours.get(*key) != theirs.get(*key);
        let difference = |key: &String| Self {
            key: key.clone(),
            ours: value(&ours, key),
            theirs: value(&theirs, key),
        };
        Ok(keys.into_iter().filter(differ).map(difference).collect())
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
