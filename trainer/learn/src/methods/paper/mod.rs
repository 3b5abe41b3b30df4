//! ALMA as published (dissertation chapter 7 and its public code): the preset `paper`.
//!
//! Both levels learn from windows of whole episodes. The low level learns the utilities of teams
//! through an attention mixer, one value per subtask; the high level learns a critic of allocations
//! and a policy that proposes them (amortised Q-learning). Nothing here is shortened: what is faster
//! than the public code is an exact rewrite of it.

pub mod allocation;
pub mod low_level;
mod popart;
mod windows;

pub use popart::PopArt;
pub use windows::{NO_ACTION, NO_TASK, WindowShape, Windows};
