//! What the agents of a team are: one utility network, and what it sees of a state (dissertation section 7.3).

mod conditioning;
mod entity_attention;
mod learned;
mod network_policy;
mod operations;
mod saved_network;
mod task_order;
mod team_batch;
mod utility;
mod utility_input;
mod utility_pass;

pub use conditioning::Conditioning;
pub(crate) use entity_attention::{AttentionGradients, AttentionWeights, EntityAttention};
pub(crate) use learned::open_nothing;
pub use learned::{Learned, OpenLearned};
pub use network_policy::NetworkPolicy;
pub(crate) use saved_network::{network_of, tensors};
pub use task_order::TaskOrder;
pub(crate) use team_batch::random_action;
pub use team_batch::{Columns, NO_ACTION, TeamBatch, best_action};
pub use utility::{Tensor, UtilityNetwork, UtilityShape, UtilityWeights};
pub use utility_input::UtilityInput;
pub(crate) use utility_input::sized;
pub use utility_pass::UtilityPass;
