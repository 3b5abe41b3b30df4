//! What the agents of a team are: one utility network, and what it sees of a state (dissertation section 7.3).

mod layers;
mod policy;
mod team_batch;
mod utility;

pub(crate) use layers::stacked;
pub use layers::{Looked, UtilityInput, UtilityLayers};
pub use policy::NetworkPolicy;
pub use sortie_learn::subtasks::NO_ACTION;
pub use team_batch::{Columns, Conditioning, TaskOrder, TeamBatch};
pub use utility::{UtilityNetwork, UtilityShape, UtilityView, transpose};
