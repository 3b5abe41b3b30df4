//! MAAC: multi-actor-attention-critic (Iqbal and Sha 2019; dissertation chapter 3).
//!
//! Every agent has a reward and a policy of its own; a critic that looks at the others by attention values its actions
//! while it learns. Deployed are the policies alone.

mod acting;
mod attention;
mod batch;
mod config;
mod critic;
mod deployed;
mod drawing;
mod groups;
mod joint;
mod learner;
mod losses;
mod method;
mod policies;
mod presets;
mod replay;
mod values;

pub use batch::{Batch, Running};
pub use config::{
    Config, CriticKind, CriticShape, EntropyConfig, NetworkConfig, OptimiserConfig, OwnActions,
    PolicyValues, ReplayConfig, ReturnsConfig, UpdateConfig,
};
pub use critic::Critic;
pub use drawing::Draw;
pub use groups::{Group, Groups, Rows};
pub use learner::Learner;
pub use method::Maac;
pub use policies::Policies;
pub use presets::{COMA, COMA_SAC, DDPG, MAAC, MADDPG, MADDPG_SAC};
pub use replay::{Future, Outcome, Place, Replay};
