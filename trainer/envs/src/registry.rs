//! The environments by their names, for command lines and files.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::string::{String, ToString};

use crate::environment::{Environment, Split};

pub use crate::entry::{Choice, Entry, EnvironmentError, Setting};

/// Every environment of this crate. Learners know none of them: they are handed an [`Environment`].
pub const ENVIRONMENTS: &[Entry] = &[
    crate::save_the_city::ENTRY,
    crate::group_matching::ENTRY,
    crate::particle::ENTRY,
    crate::gridworld::ENTRY,
    crate::skirmish::ENTRY,
    crate::smax::ENTRY,
    crate::routing::ENTRY,
    crate::crafting::ENTRY,
    crate::treasure_rooms::ENTRY,
];

/// An environment by the name that `--env` takes: `NAME` or `NAME/SET`.
///
/// # Errors
/// No environment has that name, or it refuses the choice.
pub fn open(
    name: &str,
    split: Split,
    instances: usize,
    settings: &BTreeMap<String, Setting>,
) -> Result<Box<dyn Environment>, EnvironmentError> {
    let (name, set) = match name.split_once('/') {
        Some((name, set)) => (name, Some(set)),
        None => (name, None),
    };
    let entry = ENVIRONMENTS.iter().find(|entry| entry.name == name);
    let entry = entry.ok_or_else(|| EnvironmentError::Unknown {
        name: name.to_string(),
        known: ENVIRONMENTS.iter().map(|entry| entry.name).collect(),
    })?;
    (entry.open)(&Choice { set, split, instances, settings })
}
