//! ALMA learned from records: the preset `fast`.
//!
//! One run learns both levels. The agents learn from records: one step of one subtask's team, with the
//! rewards of the next steps. The allocator learns from its decisions, see [`team_value`]. Compared with
//! the dissertation: records instead of windows, value decomposition by a sum instead of a mixing
//! network, n-step returns, optional potential shaping, Adam, averaged weights, search instead of a
//! proposal network.

mod conditioning;
pub mod config;
mod deciding;
mod entity_attention;
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
mod network_policy;
mod observer;
mod operations;
mod replay;
mod rollout;
mod saved_network;
mod team_batch;
pub mod team_value;
mod temporal_difference;
#[cfg(test)]
mod toy;
mod utility;
mod utility_pass;

pub use conditioning::Conditioning;
pub use config::{Allocation, Config};
pub(crate) use entity_attention::{AttentionGradients, AttentionWeights, EntityAttention};
pub use history::{History, Reached, Returns, StepRewards};
pub use learner::{Experience, Knowledge, Learner, Loss, Networks, Parameters, Pick, Samples};
pub use method::{Records, agents_learner, allocator_learner};
pub use mixed_network::MixedNetwork;
pub use mixer::{Mixer, MixerKind, MixerPass, MixerShape, MixerTensor, Teams};
pub use moments::{Moment, Moments};
pub use network_policy::NetworkPolicy;
pub use observer::Observer;
pub use replay::{Record, Replay, Sample};
pub use rollout::{Behaviour, Memory, Rollout};
pub(crate) use saved_network::{network_of, tensors};
pub(crate) use team_batch::random_action;
pub use team_batch::{Columns, NO_ACTION, TeamBatch, best_action};
pub use temporal_difference::Chunk;

pub use utility::{Tensor, UtilityNetwork, UtilityShape, UtilityWeights};
pub(crate) use utility_pass::sized;
pub use utility_pass::{UtilityInput, UtilityPass};
