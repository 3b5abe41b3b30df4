//! What environments need to read recorded episodes and to compare them with what a replay gives.

mod comparison;
mod error;
mod fields;

pub(crate) use comparison::Comparison;
pub use comparison::{Mismatch, Replay};
pub use error::GoldenError;
pub(crate) use fields::Field;
