//! What the agents of a team are: one utility network, and what it sees of a state (dissertation section 7.3).

mod team_batch;
mod utility;

pub use sortie_learn::subtasks::NO_ACTION;
pub use team_batch::{Columns, Conditioning, TaskOrder, TeamBatch};
pub(crate) use utility::stacked;
#[cfg(test)]
pub(crate) use utility::tests::network;
pub use utility::{
    Looked, NetworkPolicy, UtilityInput, UtilityLayers, UtilityNetwork, UtilityShape, UtilityView,
    transpose,
};
