//! The operators of an allocator that proposes: trunk, step and critic (dissertation section 7.4).
//!
//! They hold weights and sizes only. What runs them is [`crate::allocate::ProposalAllocator`], which shares work among
//! proposals; so they have no places in the arena, stand in programs of [`crate::plan::Network::Proposals`] alone, and
//! answer with an error where they are run as one step of a program.

pub(crate) mod arena;

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::{LAYOUT_TILES, Linear, Sizes, slice};
use crate::kernels::product::padded;
use crate::limits;
use crate::policy::DecideError;

/// The layers of attention among rows. Heads are padded among the outputs of query, key and value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct RowAttention {
    /// Heads.
    pub heads: u32,
    /// W_q, divided by the root of the head width.
    pub query: Linear,
    /// W_k.
    pub key: Linear,
    /// W_v.
    pub value: Linear,
    /// W_o; its inputs are the heads' outputs, each padded.
    pub output: Linear,
}

impl RowAttention {
    /// Floats of all heads' queries, keys or values of one row.
    pub(crate) fn inner(&self) -> usize {
        usize::from(self.output.inputs)
    }

    /// Floats of one head, padded; never zero.
    #[inline(always)]
    pub(crate) fn head_width(&self) -> usize {
        self.inner().checked_div(self.heads as usize).unwrap_or(0).max(1)
    }

    /// Whether rows of `width` go in and come out.
    fn check(&self, sizes: &Sizes, width: u16) -> bool {
        let inner = self.inner();
        let fits = |layer: &Linear| {
            layer.check(sizes)
                && layer.inputs == width
                && usize::from(layer.outputs) == inner
                && layer.padded_outputs() == inner
        };
        let head = self.head_width();
        [&self.query, &self.key, &self.value].into_iter().all(fits)
            && self.output.check(sizes)
            && self.output.outputs == width
            && head.is_multiple_of(8)
            && head * self.heads as usize == inner
    }

    /// Multiply-adds of `rows` that attend to each other.
    fn multiply_adds(&self, rows: u64) -> u64 {
        let layers = [&self.query, &self.key, &self.value, &self.output];
        let per_row: u64 = layers.iter().map(|layer| layer.multiply_adds()).sum();
        rows * per_row + 2 * rows * rows * self.inner() as u64
    }
}

/// Vectors of weights, one behind the other, each padded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Vectors {
    /// Where the first starts.
    pub weights: u32,
    /// How many there are.
    pub count: u16,
    /// Floats of one, without padding.
    pub width: u16,
}

impl Vectors {
    fn padded_width(&self) -> usize {
        padded(usize::from(self.width))
    }

    fn check(&self, sizes: &Sizes, count: usize, width: u16) -> bool {
        let floats = (usize::from(self.count) * self.padded_width()) as u64;
        usize::from(self.count) == count
            && self.width == width
            && sizes.holds_weights(self.weights, floats)
    }

    /// All vectors, padded.
    pub(crate) fn of<'w>(&self, weights: &'w [f32]) -> Result<&'w [f32], DecideError> {
        slice(weights, self.weights, usize::from(self.count) * self.padded_width())
    }
}

/// The trunk: embeds all entities, lets the rows of one subtask attend to each other, and sums them up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct EmbedTasks {
    /// d features to E; no ReLU follows, subtasks are added first.
    pub embed: Linear,
    /// What belonging to each subtask adds `[T, E]`.
    pub tasks: Vectors,
    /// Attention among the rows of a subtask, behind a ReLU.
    pub attention: RowAttention,
}

/// The step: where an agent's pointer goes, and what its choice changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PointerLogits {
    /// What a subtask's other entities, its agents, and no count at all add to its embedding `[3, E]`.
    pub counts: Vectors,
    /// The one factor of all logits, 1 / √E.
    pub scale: Vectors,
    /// The part of the update that a subtask's embedding goes into, behind a ReLU.
    pub from_task: Linear,
    /// The part that the agent's embedding goes into, behind a ReLU, with the bias.
    pub from_agent: Linear,
}

/// The critic: what a whole allocation is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct ScoreAllocations {
    /// d features to E; no ReLU follows, subtasks and counts are added first.
    pub embed: Linear,
    /// What belonging to each subtask adds `[T, E]`.
    pub tasks: Vectors,
    /// What a subtask's agents, its other entities, and no count at all add to those who belong to it `[3, E]`.
    pub counts: Vectors,
    /// Attention among all rows, behind a ReLU.
    pub attention: RowAttention,
    /// E to the value, behind the mean over agents.
    pub head: Linear,
}

/// Counts that a subtask's embedding depends on, and the constant.
pub(crate) const COUNTS: usize = 3;

impl Operator for EmbedTasks {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let width = self.embed.outputs;
        self.embed.check(sizes)
            && u32::from(self.embed.inputs) == sizes.features
            && (1..=limits::TASKS).contains(&self.task_count())
            && self.tasks.check(sizes, self.task_count(), width)
            && self.attention.check(sizes, width)
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        visible * self.embed.multiply_adds() + self.attention.multiply_adds(visible)
    }
}

impl EmbedTasks {
    /// Subtasks T.
    pub fn task_count(&self) -> usize {
        usize::from(self.tasks.count)
    }
}

impl Operator for PointerLogits {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let width = self.from_task.outputs;
        let square =
            |layer: &Linear| layer.check(sizes) && (layer.inputs, layer.outputs) == (width, width);
        square(&self.from_task)
            && square(&self.from_agent)
            && self.counts.check(sizes, COUNTS, width)
            && self.scale.check(sizes, 1, 1)
    }

    /// Of one agent and one proposal, only the chosen subtask being updated.
    fn multiply_adds(&self, _: u64) -> u64 {
        self.from_task.multiply_adds()
    }
}

impl Operator for ScoreAllocations {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let width = self.embed.outputs;
        self.embed.check(sizes)
            && u32::from(self.embed.inputs) == sizes.features
            && self.tasks.check(sizes, usize::from(self.tasks.count), width)
            && self.counts.check(sizes, COUNTS, width)
            && self.attention.check(sizes, width)
            && self.head.check(sizes)
            && (self.head.inputs, self.head.outputs) == (width, 1)
    }

    /// Of one allocation.
    fn multiply_adds(&self, visible: u64) -> u64 {
        let embed = visible * self.embed.multiply_adds();
        embed + self.attention.multiply_adds(visible) + self.head.multiply_adds()
    }
}

/// The three operators of an allocator that proposes.
#[derive(Clone, Copy, Debug)]
pub struct ProposalNetwork {
    /// The trunk.
    pub trunk: EmbedTasks,
    /// The step.
    pub step: PointerLogits,
    /// The critic.
    pub critic: ScoreAllocations,
}

impl ProposalNetwork {
    /// Whether the parts, each of which is right by itself, fit each other.
    pub(crate) fn fits(&self) -> bool {
        self.trunk.embed.outputs == self.step.from_task.outputs
            && self.trunk.tasks.count == self.critic.tasks.count
    }
}
