//! The particle world against its rule book, recorded episodes of the reference, and its laws.

mod conformance;
mod golden;
mod liar;
mod picture;
mod recorded;
mod returns;
mod rules;
mod states;
mod throughput;

use sortie_envs::registry::Setting;
use sortie_envs::{Environment, Split, open};

/// One instance of a set with these settings.
fn opened(set: &str, settings: &[(&str, Setting)]) -> Box<dyn Environment> {
    let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone()));
    open(&format!("particle/{set}"), Split::Train, 1, &settings.collect()).unwrap()
}

/// The state of the instance.
fn saved(environment: &dyn Environment) -> Vec<u8> {
    let mut state = Vec::new();
    environment.save(0, &mut state);
    state
}
