//! The drawn choice among the available actions.

use serde::{Deserialize, Serialize};

use super::{Place, Sizes};

/// A draw ([`crate::choose::masked_sample`]); its input is the program's logits `[U]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MaskedSample {
    /// The logits, as many as there are actions.
    pub from: Place,
}

impl MaskedSample {
    pub(super) fn check(&self, sizes: &Sizes) -> bool {
        sizes.holds(&self.from) && self.from.len == sizes.actions
    }
}
