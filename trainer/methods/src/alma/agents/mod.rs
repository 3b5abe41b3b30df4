//! What the agents of a team are: one utility network, and what it sees of a state (dissertation section 7.3).

mod entity_attention;
mod layers;
mod team_batch;
mod utility;
mod utility_pass;

pub use entity_attention::UtilityInput;
pub(crate) use entity_attention::{AttentionGradients, AttentionWeights, EntityAttention};
pub use layers::UtilityLayers;
pub(crate) use layers::{TrunkLayers, drawn};
pub use sortie_learn::subtasks::NO_ACTION;
pub(crate) use team_batch::random_action;
pub use team_batch::{Columns, Conditioning, TaskOrder, TeamBatch, best_action};
pub use utility::{Tensor, UtilityNetwork, UtilityShape, UtilityWeights};
pub(crate) use utility::{tensors, transpose};
pub use utility_pass::{NetworkPolicy, UtilityPass};
