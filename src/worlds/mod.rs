//! The built-in worlds of `run`: environments behind the runtime's traits.

pub(crate) mod rules;
pub(crate) mod tally;
pub(crate) mod world;
