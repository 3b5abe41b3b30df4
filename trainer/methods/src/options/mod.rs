//! Options of agents that go from milestone to milestone: how they are played, kept, and learned from.

mod deployed;
mod play;
mod priorities;
mod replay;
mod windows;

pub(crate) use deployed::deployed;
pub use play::Mask;
pub(crate) use play::{Actors, Chances, PlayRules, Player, Running};
pub(crate) use priorities::importance;
pub(crate) use replay::{End, Finished, Moment, NONE, OptionPlace, Place, Replay};
pub(crate) use windows::{Course, CourseRules, ReturnRules, Window, course, window};
