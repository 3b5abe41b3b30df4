//! The largest sizes that the runtime and its wire format can express.

/// Most agents of one team.
pub const AGENTS: usize = 64;
/// Most entities (agents included) in one frame.
pub const ENTITIES: usize = 128;
/// Most subtasks in one frame.
pub const TASKS: usize = 32;
/// Most actions of one agent.
pub const ACTIONS: usize = 256;
/// Most features of one entity, the last action not counted.
pub const FEATURES: usize = 2048;
/// Most bytes of one frame's payload.
pub const FRAME_BYTES: usize = (1 << 20) + (1 << 16);
/// Most allocations that an allocator proposes in one decision.
pub const PROPOSALS: usize = 256;
