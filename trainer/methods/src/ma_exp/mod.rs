//! MA-Exp: coordinated exploration by intrinsic rewards (Iqbal and Sha 2019; dissertation chapter 4).
//!
//! A team shares one reward that it rarely sees. Each of several heads explores for something else, by how often agents
//! have been where; one explores for nothing and is deployed. What is known of the world is kept by places, and values
//! are what follows from it. Frozen policies are tried out while others go on learning, and the best is deployed.

mod audition;
mod config;
mod deployed;
mod learner;
mod method;
mod model;
mod presets;
mod selector;
mod shares;
mod table;
mod thoughts;

pub use crate::multi_explore as networks;
pub use crate::novelty::counts::{Counts, novelty};
pub use crate::novelty::intrinsic::{Intrinsic, Types};
pub use crate::novelty::places::{Columns, Place};
pub use audition::Audition;
pub use config::{AuditionConfig, Config, ExplorationConfig, HeadsConfig, ValuesConfig};
pub use learner::{Deed, Learner, Rules};
pub use method::MaExp;
pub use model::{Outcome, Way};
pub use presets::MA_EXP;
pub use selector::Selector;
pub use shares::Shares;
pub use table::{Lanes, Row, Table, Terms, Version, Worth};
