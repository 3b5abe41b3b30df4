//! The published learner of MA-Exp (Iqbal and Sha 2019; dissertation chapter 4), the preset `paper`: networks with a head for each type of intrinsic reward, and a meta-policy between heads.

mod config;
mod meta;
mod method;
mod moments;

pub use crate::actor_critic::batch::Batch;
pub use crate::actor_critic::drawing::Draw;
pub use crate::actor_critic::groups::{Group, Groups, Rows};
pub use crate::actor_critic::heads::{
    HeadBatch, HeadCritic, HeadCriticShape, HeadLearner, HeadRules,
};
pub use crate::actor_critic::policies::{Policies, PolicyShape};
pub use config::{
    Config, HeadsConfig, MetaConfig, NetworkConfig, OptimiserConfig, ReplayConfig, ReturnsConfig,
};
pub use meta::MetaPolicy;
pub use method::MultiExplore;
pub use moments::Moments;

pub(crate) use config::{ALL_KEYS, LEARNER, NETWORKS, is_networks};
