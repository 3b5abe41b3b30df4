//! ALMA: agents act on the subtask that an allocator gives them (dissertation chapter 7).

mod utility;
mod utility_pass;

pub use utility::{Tensor, UtilityNetwork, UtilityShape, UtilityWeights};
pub use utility_pass::{UtilityInput, UtilityPass};
