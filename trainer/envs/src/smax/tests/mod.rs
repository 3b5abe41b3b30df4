//! SMAX against its rule book, recorded episodes of the reference, and the laws of all environments.

mod golden;
mod laws;
mod rules;

use std::collections::BTreeMap;

use super::environment::Smax;
use super::scenarios::Roster;
use super::units::Rules;
use crate::registry::Setting;
use crate::{Environment, Split, open};

/// One instance of a set with these settings.
fn opened(set: &str, settings: &[(&str, Setting)]) -> Box<dyn Environment> {
    let settings = settings.iter().map(|(name, value)| ((*name).into(), value.clone()));
    open(&format!("smax/{set}"), Split::Train, 1, &settings.collect::<BTreeMap<_, _>>()).unwrap()
}

/// The same as its own type.
fn smax(set: &str, rules: Rules) -> Smax {
    Smax::new(rules, Roster::named(set).unwrap(), 1)
}

/// The state of the instance.
fn saved(environment: &dyn Environment) -> Vec<u8> {
    let mut state = Vec::new();
    environment.save(0, &mut state);
    state
}
