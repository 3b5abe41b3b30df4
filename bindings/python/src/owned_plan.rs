//! A loaded plan together with the bytes that it is used in.

use self_cell::self_cell;
use sortie_core::plan::{AlignedBytes, PlanError};

pub(crate) type LoadedPlan<'a> = sortie_core::plan::Plan<'a>;

self_cell!(
    pub(crate) struct OwnedPlan {
        owner: AlignedBytes,
        #[covariant]
        dependent: LoadedPlan,
    }
);

impl OwnedPlan {
    pub(crate) fn load(bytes: AlignedBytes) -> Result<Self, PlanError> {
        Self::try_new(bytes, |bytes| LoadedPlan::load(bytes.as_slice()))
    }

    pub(crate) fn plan(&self) -> &LoadedPlan<'_> {
        self.borrow_dependent()
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        self.borrow_owner().as_slice()
    }

    /// Working memory of one decision.
    pub(crate) fn arena(&self) -> AlignedBytes {
        AlignedBytes::zeroed(self.plan().arena_bytes())
    }
}
