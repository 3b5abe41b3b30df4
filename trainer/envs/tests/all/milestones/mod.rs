//! Crafting and the treasure's rooms against their rule books, recorded episodes of the public code, and their laws.

mod conformance;
mod recorded;
mod rules;
mod starts;

use std::collections::BTreeMap;

use sortie_envs::registry::Setting;
use sortie_envs::{Environment, EnvironmentError, Split};

fn open(
    name: &str,
    split: Split,
    settings: &[(&str, Setting)],
) -> Result<Box<dyn Environment>, EnvironmentError> {
    let settings: BTreeMap<_, _> =
        settings.iter().map(|(name, value)| ((*name).to_string(), value.clone())).collect();
    sortie_envs::open(name, split, 1, &settings)
}
