//! The tensors of the allocation networks as the public code has them: for export and for import.
//!
//! Every matrix is `[out, in]`, row-major. E is the width, d the number of features of an entity, T the
//! number of subtasks that the networks can tell apart (their task columns, spare ones included).

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

/// The tensors of the allocation critic `Q(s, b)`.
#[derive(Clone, Debug, PartialEq)]
pub struct CriticWeights {
    /// The sizes.
    pub shape: AllocationShape,
    /// `in_fc_ent.weight [E, d]`
    pub entity_weight: Vec<f32>,
    /// `in_fc_ent.bias [E]`
    pub entity_bias: Vec<f32>,
    /// `in_fc_alloc.fc.weight [E, T]`, without bias.
    pub task_weight: Vec<f32>,
    /// `count_embed.count_embed.weight [E, 2]`: agents of the task, its other entities; the sum with the
    /// bias is multiplied by 0.2.
    pub count_weight: Vec<f32>,
    /// `count_embed.count_embed.bias [E]`
    pub count_bias: Vec<f32>,
    /// `attn.in_trans.weight [3 E, E]`: queries, keys, values; without bias.
    pub attention_in_weight: Vec<f32>,
    /// `attn.out_trans.weight [E, E]`
    pub attention_out_weight: Vec<f32>,
    /// `attn.out_trans.bias [E]`
    pub attention_out_bias: Vec<f32>,
    /// `out_fc.weight [1, E]`
    pub value_weight: Vec<f32>,
    /// `out_fc.bias [1]`
    pub value_bias: Vec<f32>,
    /// `popart_weight`: the value in normalised units is `popart_weight * out_fc(..) + popart_bias`.
    pub popart_weight: f32,
    /// `popart_bias`
    pub popart_bias: f32,
    /// Mean of the targets: the value in real units is `normalised * deviation + mean`.
    pub mean: f32,
    /// Standard deviation of the targets, positive.
    pub deviation: f32,
}

/// The tensors of the policy `f(b | s)` that proposes allocations.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyWeights {
    /// The sizes.
    pub shape: AllocationShape,
    /// `fc1.weight [E, d]`
    pub entity_weight: Vec<f32>,
    /// `fc1.bias [E]`
    pub entity_bias: Vec<f32>,
    /// `task_embed.fc.weight [E, T]`, without bias.
    pub task_weight: Vec<f32>,
    /// `attn.in_trans.weight [3 E, E]`: queries, keys, values; without bias.
    pub attention_in_weight: Vec<f32>,
    /// `attn.out_trans.weight [E, E]`
    pub attention_out_weight: Vec<f32>,
    /// `attn.out_trans.bias [E]`
    pub attention_out_bias: Vec<f32>,
    /// `count_embed.weight [E, 2]`: other entities of the task, its agents; both counts times 0.2.
    pub count_weight: Vec<f32>,
    /// `count_embed.bias [E]`, not scaled.
    pub count_bias: Vec<f32>,
    /// `embed_update.weight [E, 2 E]`: the task's columns, then the agent's.
    pub update_weight: Vec<f32>,
    /// `embed_update.bias [E]`
    pub update_bias: Vec<f32>,
}
