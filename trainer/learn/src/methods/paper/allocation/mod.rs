//! The high level: who works at what (dissertation section 7.2, amortised Q-learning).
//!
//! A critic values allocations of agents to subtasks; a policy proposes some, of which the critic takes
//! the best.

mod weights;

pub use weights::{AllocationShape, CriticWeights, PolicyWeights};
