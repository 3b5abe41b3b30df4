//! The built-in worlds of `run`: environments behind the runtime's traits.

pub(crate) mod save_the_city;
pub(crate) mod tally;
