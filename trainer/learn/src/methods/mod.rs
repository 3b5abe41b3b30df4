//! Algorithms, one folder each: networks, loss, rollout rule, configuration.

pub mod alma;
pub mod paper;
mod trainer;

pub use trainer::Trainer;
