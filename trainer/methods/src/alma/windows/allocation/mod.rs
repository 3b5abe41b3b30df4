//! The high level: who works at what (dissertation section 7.2, amortised Q-learning).
//!
//! A critic values allocations of agents to subtasks; a policy proposes some, of which the critic takes
//! the best.

mod decide;
mod level;
mod networks;
mod proposals;
mod rows;
#[cfg(test)]
mod tests;
mod tree;

use rand_core::Rng;
use sortie_nn::random::Generator;

use super::WindowShape;
use super::config::{AllocationConfig, Config};
use decide::shuffled;

pub(super) use rows::COUNT_SCALE;

pub use decide::{AllocationNetworks, Decided, Decider, TaskColumns};
pub use level::{AllocationLevel, AllocationReport, LastStep};
pub use networks::{AllocationCritic, AllocationPolicy};
pub use proposals::Noise;
pub use rows::{Rows, States};

/// How the high level learns.
#[derive(Clone, Debug, PartialEq)]
pub struct AllocationLearning {
    /// Sizes of both networks.
    pub shape: AllocationShape,
    /// Proposals, rows, and what they are worth.
    pub config: AllocationConfig,
    /// Step size of both optimisers.
    pub learning_rate: f32,
    /// Limit of the norm of each network's gradient.
    pub gradient_norm: f32,
    /// Follows the public code where it differs from the dissertation: in the policy's loss the last row
    /// does not age, and the critic's head is rescaled only after its output has been compared.
    pub as_public_code: bool,
}

impl AllocationLearning {
    /// As a run is configured, in an environment of these sizes.
    pub fn of(config: &Config, sizes: WindowShape) -> Self {
        let AllocationConfig { width, heads, extra_tasks, .. } = config.allocation;
        let (features, columns) = (sizes.features, sizes.tasks + extra_tasks);
        Self {
            shape: AllocationShape { features, columns, width, heads },
            config: config.allocation.clone(),
            learning_rate: config.low_level.learning_rate,
            gradient_norm: config.low_level.clip,
            as_public_code: false,
        }
    }
}

/// The random choices of a step.
#[derive(Clone, Debug)]
pub struct StepDraws<'a> {
    /// Columns of the policy and of the critic where it values proposals.
    pub proposals: TaskColumns,
    /// Columns of the critic where it values stored allocations, `[T]`.
    pub stored: Vec<u8>,
    /// Columns of the target critic, `[T]`.
    pub target: Vec<u8>,
    /// What the proposals are drawn with.
    pub noise: Noise<'a>,
}

impl StepDraws<'_> {
    /// Draws for T subtasks of networks with so many task columns.
    pub fn draw(tasks: usize, columns: usize, generator: &mut Generator) -> Self {
        Self {
            proposals: TaskColumns::shuffled(tasks, columns, generator),
            stored: shuffled(tasks, columns, generator),
            target: shuffled(tasks, columns, generator),
            noise: Noise::Seeded { seed: generator.next_u64(), greedy_first: false },
        }
    }
}

/// Sizes of both allocation networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AllocationShape {
    /// Features d of an entity, without its last action.
    pub features: usize,
    /// Task columns T of the embeddings, spare ones included.
    pub columns: usize,
    /// Width E of embeddings and attention.
    pub width: usize,
    /// Attention heads H, a divisor of the width.
    pub heads: usize,
}
