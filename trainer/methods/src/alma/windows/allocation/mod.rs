//! The high level: who works at what (dissertation section 7.2, amortised Q-learning).
//!
//! A critic values allocations of agents to subtasks; a policy proposes some, of which the critic takes
//! the best.

mod critic;
mod decide;
mod gathers;
mod lane;
mod learning;
mod level;
mod networks;
mod proposals;
mod rows;
mod states;
mod teams;
#[cfg(test)]
mod tests;
mod tree;
mod trunk;
mod weights;

pub use decide::{AllocationNetworks, Decided, Decider, Proposed, TaskColumns};
pub use learning::{AllocationLearning, StepDraws};
pub use level::{AllocationLevel, AllocationReport, AllocationState, LastStep};
pub use networks::{AllocationCritic, AllocationPolicy};
pub use proposals::Noise;
pub use rows::{RowRules, Rows};
pub use states::{StateView, States};
pub use weights::{AllocationShape, CriticWeights, PolicyWeights};
