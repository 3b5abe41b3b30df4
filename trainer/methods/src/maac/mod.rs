//! MAAC: multi-actor-attention-critic (Iqbal and Sha 2019; dissertation chapter 3).
//!
//! Every agent has a reward and a policy of its own; a critic that looks at the others by attention values its actions
//! while it learns. Deployed are the policies alone.

mod attention;
mod config;
mod critic;
mod joint;
mod learner;
mod method;
mod presets;

pub use config::{
    Config, CriticKind, CriticShape, EntropyConfig, NetworkConfig, OptimiserConfig, OwnActions,
    PolicyValues, ReplayConfig, ReturnsConfig, UpdateConfig,
};
pub use critic::Critic;
pub use learner::Learner;
pub use method::Maac;
pub use presets::{COMA, COMA_SAC, DDPG, MAAC, MADDPG, MADDPG_SAC};

pub use crate::actor_critic::batch::Batch;
pub use crate::actor_critic::drawing::Draw;
pub use crate::actor_critic::groups::{Group, Groups, Rows};
pub use crate::actor_critic::policies::Policies;
pub use crate::actor_critic::running::Running;
