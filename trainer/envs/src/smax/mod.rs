//! SMAX: two teams of units fight on an open square, one of them led by a fixed rule.
//!
//! Agrees with PyPI `jaxmarl` 0.2.0, and by the setting `rules=classic` with its versions 0.0.3 to 0.1.0, which published
//! results were made with, from the same states, orders and draws. An order says one thing only: walk, stop, or stand and
//! shoot at this one foe whenever it is within range. A unit at the border dies, and its foes are paid for it.

mod battle;
mod environment;
mod observation;
mod scenarios;
#[cfg(test)]
mod tests;
mod units;

pub use environment::{ENTRY, Smax};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
