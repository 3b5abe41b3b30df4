//! A deep Q-network without goals (Mnih et al. 2015): what HAL is compared with (Rainbow of dissertation chapter 6).
//!
//! It learns the values of actions alone, and is paid for what it reaches.

mod config;
mod method;
mod presets;
mod returns;

pub use config::{Config, ExplorationConfig, MeasuredConfig, NetworkConfig, ReturnsConfig};
pub use method::Dqn;
pub use presets::DQN;

pub use crate::options::{ReplayConfig, WeightsConfig};
pub use crate::pictures::Body;
