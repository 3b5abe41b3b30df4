//! The choice among the available actions.

use serde::{Deserialize, Serialize};

use super::{Place, Sizes};

/// Greedy choice ([`crate::choose::masked_argmax`]); its input is the program's utilities `[U]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MaskedArgmax {
    /// The utilities, as many as there are actions.
    pub from: Place,
}

impl MaskedArgmax {
    pub(super) fn check(&self, sizes: &Sizes) -> bool {
        sizes.holds(&self.from) && self.from.len == sizes.actions
    }
}
