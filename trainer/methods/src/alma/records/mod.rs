//! ALMA learned from records: the preset `fast`.
//!
//! One run learns both levels. The agents learn from records: one step of one subtask's team, with the
//! rewards of the next steps. The allocator learns from its decisions, see [`team_value`]. Compared with
//! the dissertation: records instead of windows, value decomposition by a sum instead of a mixing
//! network, n-step returns, optional potential shaping, Adam, averaged weights, search instead of a
//! proposal network.

pub mod config;
mod deciding;
#[cfg(test)]
mod fixed;
mod history;
mod learner;
mod method;
mod mixed_network;
mod mixer;
mod moments;
#[cfg(test)]
mod naive;
mod observer;
mod replay;
mod rollout;
mod side;
mod team_columns;
pub mod team_value;
mod temporal_difference;
#[cfg(test)]
mod toy;

pub use config::Config;
pub(crate) use deciding::STAND_INS;
pub use history::{History, Reached, Returns, StepRewards};
pub use learner::{Experience, Knowledge, Learner, Loss, Networks, Parameters, Pick, Samples};
pub use method::{Records, agents_learner, allocator_learner};
pub use mixed_network::MixedNetwork;
pub use mixer::{Mixer, MixerKind, MixerPass, MixerShape, MixerTensor, Teams};
pub use moments::{Moment, Moments};
pub use observer::Observer;
pub use replay::{Record, Replay, Sample};
pub use rollout::{Behaviour, Memory, Rollout};
pub use temporal_difference::Chunk;
