//! Value factorisation: A-QMIX, VDN and REFIL with its oracles (dissertation chapter 5).
//!
//! Agents share one network; a mixer makes the value of the team from the utilities of their chosen
//! actions, so that both learn from the team's reward. REFIL learns besides from imagined utilities, for
//! which each agent sees only its part of a random partition, or only the rest.

mod acting;
mod agent;
mod buffers;
mod chunk;
mod config;
mod deployed;
mod episodes;
mod experience;
mod keys;
mod learner;
mod looking;
mod memory;
mod method;
mod mixer;
mod optimiser;
mod partition;
mod presets;
mod replay;
mod row_scores;
mod scenes;
mod split_attention;
mod split_lists;
mod temporal_difference;
mod tensors;

pub use acting::Acting;
pub use agent::{AgentPass, AgentShape};
pub use config::{
    Config, ImaginationConfig, MixerConfig, NetworkConfig, ReplayConfig, ReturnsConfig, Rule, Unit,
    UpdateConfig,
};
pub use episodes::{Ahead, Episode, Episodes};
pub use learner::{Learner, Update};
pub use memory::Moment;
pub use method::ValueFactorisation;
pub use mixer::{Hypernetworks, MixerKind, MixerPass, MixerShape, Slopes, Teams};
pub use partition::Partitions;
pub use presets::{QMIX, REFIL, VDN};
pub use replay::{End, Future, Place, Replay};
pub use scenes::Scenes;
pub use temporal_difference::{Batch, Losses, Network, NetworkShape, TemporalDifference};

#[cfg(test)]
mod tests;
