//! HAL: hierarchical affordance learning (Costales, Iqbal and Sha 2022; dissertation chapter 6).
//!
//! A meta-controller chooses which milestone to go for, a controller acts until a milestone is reached. Which milestones
//! can be reached next is learned from what happened, and masks the choice.

mod affordances;
mod config;
mod controller;
mod filter;
mod meta;
mod method;
mod presets;
#[cfg(test)]
mod tests;

pub use config::{
    AffordancesConfig, Config, ExplorationConfig, MeasuredConfig, MetaConfig, NetworkConfig,
    ReturnsConfig,
};
pub use filter::tolerance;
pub use method::{Hal, MaskCounts, Measured};
pub use presets::{H_DQN, HAL, HAL_ORACLE};

pub use crate::options::{Mask, ReplayConfig, WeightsConfig};
pub use crate::pictures::Body;
