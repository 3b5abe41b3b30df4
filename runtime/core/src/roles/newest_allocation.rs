//! Keeps the newest valid allocation.

use super::Counters;
use crate::wire::{AllocMsg, AllocationFault, FrameFormat};

/// The largest (term, epoch) seen so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct NewestAllocation {
    newest: Option<AllocMsg>,
}

impl NewestAllocation {
    pub(super) fn get(&self) -> Option<&AllocMsg> {
        self.newest.as_ref()
    }

    /// Keeps `offered` if it is valid and newer; counts it otherwise.
    pub(super) fn offer(
        &mut self,
        offered: &AllocMsg,
        format: &FrameFormat,
        counters: &mut Counters,
    ) -> bool {
        match offered.check(format.schema, format.layout.shape()) {
            Err(AllocationFault::Foreign) => counters.schema_rejects += 1,
            Err(AllocationFault::Content) => counters.bad_messages += 1,
            Ok(()) if self.newest.is_some_and(|newest| offered.order() <= newest.order()) => {
                counters.old_term_rejects += 1;
            }
            Ok(()) => {
                self.newest = Some(*offered);
                return true;
            }
        }
        false
    }
}
