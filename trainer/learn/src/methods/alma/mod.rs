//! ALMA: agents act on the subtask that an allocator gives them (dissertation chapter 7).
//!
//! The low level is learned from records: one step of one building's team, with the rewards of the next
//! steps. Compared with the dissertation: records instead of windows, value decomposition by a sum
//! instead of a mixing network, n-step returns, optional potential shaping, Adam, averaged weights.

mod conditioning;
pub mod config;
mod entity_attention;
mod history;
mod learner;
mod mixer;
mod network_policy;
mod replay;
mod rollout;
mod team_batch;
pub mod team_value;
mod temporal_difference;
mod trainer;
mod utility;
mod utility_pass;

pub use conditioning::Conditioning;
pub use config::Config;
pub use history::{History, Moment, Returns, StepRewards};
pub use learner::{Knowledge, Learner, UpdateReport};
pub use mixer::{Mixer, MixerKind, MixerPass, MixerShape, MixerTensor, Teams};
pub use network_policy::NetworkPolicy;
pub use replay::{AgentStep, BuildingStep, Record, RecordLayout, Replay, Sample};
pub use rollout::{EpisodeCounts, InstanceSnapshot, Rollout};
pub use team_batch::{INPUT_COLUMNS, NO_ACTION, TeamBatch, best_action};
pub use temporal_difference::{Chunk, Networks, Pick};
pub use trainer::{Observer, Outcome, Progress, Trainer};
pub use utility::{Tensor, UtilityNetwork, UtilityShape, UtilityWeights};
pub use utility_pass::{UtilityInput, UtilityPass};
