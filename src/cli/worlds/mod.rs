//! The built-in worlds of `run`: environments behind the runtime's traits, which pages in a browser play in as well.

pub mod rules;

pub use sortie_stage::{tally, world};
