//! ALMA learned from records: the preset `fast`.
//!
//! One run learns both levels. The agents learn from records: one step of one subtask's team, with the
//! rewards of the next steps. The allocator learns from its decisions, see [`team_value`]. Compared with
//! the dissertation: records instead of windows, value decomposition by a sum instead of a mixing
//! network, n-step returns, optional potential shaping, Adam, averaged weights, search instead of a
//! proposal network.

pub mod config;
mod deciding;
mod lesson;
mod method;
mod replay;
pub mod team_value;
#[cfg(test)]
mod tests;

use sortie_learn::configuration::OptimiserConfig;
use sortie_learn::learner::Rules;

pub use config::Config;
pub(crate) use config::LEARNED;
pub use lesson::{Drawn, Experience, Lesson, Networks};
pub use method::Records;
pub use replay::{Moment, Replay, Sample};
pub use team_value::Allocator;

/// What updates do; the averaged weights begin as a plain mean.
fn rules(optimiser: &OptimiserConfig) -> Rules {
    Rules { mean_first: true, ..Rules::from(optimiser) }
}
