//! Agents that learn from milestones: how their options are played, kept, and learned from.

mod config;
mod deployed;
mod learning;
#[cfg(test)]
pub(crate) mod naive;
mod play;
pub(crate) mod presets;
mod priorities;
mod recorder;
mod replay;
mod windows;

pub(crate) use config::{REPLAY, WEIGHTS, learned_as, misfit, shown};
pub use config::{ReplayConfig, WeightsConfig};
pub(crate) use deployed::deployed;
pub(crate) use learning::{Lesson, Memory, Next, descend};
pub use play::Mask;
pub(crate) use play::{Actors, Chances, Chooser, Player};
pub(crate) use recorder::Recorder;
#[cfg(test)]
pub(crate) use replay::{End, Moment};
pub(crate) use replay::{Finished, NONE, OptionPlace, Place, Replay};
pub(crate) use windows::{CourseRules, ReturnRules, course, window};
