//! ALMA as published (dissertation chapter 7 and its public code): the preset `paper`.
//!
//! Both levels learn from windows of whole episodes. The low level learns the utilities of teams
//! through an attention mixer, one value per subtask; the high level learns a critic of allocations
//! and a policy that proposes them (amortised Q-learning). Nothing here is shortened: what is faster
//! than the public code is an exact rewrite of it.

pub mod allocation;
mod batch;
pub mod config;
mod deciding;
mod exploration;
pub mod low_level;
mod method;
mod popart;
mod replay;
mod rollout;
mod sampling;
mod times;

pub use batch::{NO_ACTION, NO_TASK, WindowShape, Windows};
pub use config::Config;
pub use deciding::{ExploringAllocator, ProposalAllocator};
pub use exploration::Exploration;
pub use method::WindowLearner;
pub use popart::{PopArt, Rescale};
pub use replay::{Episode, Moment, Replay};
pub use rollout::{Behaviour, Rollout};
pub use sampling::{SampleShape, Shaping, cut_windows, draw_episodes};
pub use times::{AllocationTimes, LowLevelTimes};
