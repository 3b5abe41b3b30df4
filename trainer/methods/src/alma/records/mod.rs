//! ALMA learned from records: the preset `fast`.
//!
//! One run learns both levels. The agents learn from records: one step of one subtask's team, with the
//! rewards of the next steps. The allocator learns from its decisions, see [`team_value`]. Compared with
//! the dissertation: records instead of windows, value decomposition by a sum instead of a mixing
//! network, n-step returns, optional potential shaping, Adam, averaged weights, search instead of a
//! proposal network.

pub mod config;
mod deciding;
mod history;
mod learner;
mod method;
mod mixer;
#[cfg(test)]
mod naive;
mod replay;
mod rollout;
pub mod team_value;
mod temporal_difference;
#[cfg(test)]
mod toy;

pub use config::Config;
pub(crate) use config::LEARNED;
pub use history::{History, Reached, Returns, StepRewards};
pub use learner::{
    Experience, Knowledge, Learner, Loss, MixedNetwork, Networks, Observer, Parameters, Pick,
    Samples,
};
pub use method::{Records, agents_learner, allocator_learner};
pub use mixer::{Mixer, MixerKind, MixerPass, MixerShape, MixerTensor, Teams};
pub use replay::{Moment, Moments, Record, Replay, Sample};
pub use rollout::{Behaviour, Memory, Rollout};
pub use temporal_difference::Chunk;
