//! A plan's guards and what they remember of one robot, in memory of the caller.

use core::slice;

use sortie_core::plan::{GuardState, Guards};

use crate::border::{Array, Span, apart};
use crate::errors::SortieError;
use crate::placed::Placed;
use crate::policy::SortiePolicy;

/// The guards of a plan, and what they remember of one robot. They live in the memory that was given to `sortie_guard`, and
/// end with it. One thread at a time uses them.
pub struct SortieGuards {
    mark: usize,
    memory: Span,
    /// The plan, in which the limits are read.
    plan: Span,
    pub(crate) guards: Guards<'static>,
    pub(crate) state: GuardState<&'static mut [f32]>,
    /// Numbers of all inputs.
    pub(crate) inputs: usize,
}

impl Placed for SortieGuards {
    const NAME: [u8; 4] = *b"GRDS";
    const ALIGNMENT: usize = align_of::<Self>();
    const MISSING: SortieError = SortieError::NoGuards;

    unsafe fn mark(at: *const Self) -> usize {
        // SAFETY: as the caller promises.
        unsafe { (&raw const (*at).mark).read() }
    }
}

impl SortieGuards {
    /// Lays the guards of a policy's plan into memory.
    ///
    /// # Safety
    /// The memory comes from [`Array::of`] and can be written, by nobody else, as long as the guards are used; the policy's
    /// plan stays as long.
    pub(crate) unsafe fn place(
        policy: &SortiePolicy,
        memory: Array<u8>,
    ) -> Result<*mut Self, SortieError> {
        policy.check_apart([memory.span()].into_iter(), [].into_iter())?;
        let guards = Guards::of_plan(policy.bytes)?.ok_or(SortieError::NoGuards)?;
        let (inputs, outputs) = (policy.plan.inputs().sum(), policy.plan.outputs().sum::<usize>());
        guards.check_fits(inputs, outputs)?;
        let before = memory.start().addr().wrapping_neg() % Self::ALIGNMENT;
        let room = memory.len().checked_sub(before + size_of::<Self>());
        if room.is_none_or(|room| room / size_of::<f32>() < outputs) {
            return Err(SortieError::MemoryTooSmall);
        }
        let start = memory.start().wrapping_add(before);
        let at = start.cast::<Self>();
        let last = start.wrapping_add(size_of::<Self>()).cast::<f32>();
        // SAFETY: inside the memory, which is the caller's to give; behind the guards, whose size is a multiple of a float's.
        unsafe { last.write_bytes(0, outputs) };
        // SAFETY: as above, and written just now.
        let last = unsafe { slice::from_raw_parts_mut(last, outputs) };
        let bytes = size_of::<Self>() + size_of_val(last);
        let memory = Array::new(start.cast_const(), bytes).span();
        // SAFETY: inside the memory, aligned, and apart from the outputs that are remembered.
        unsafe {
            let (mark, plan, state) =
                (Self::mark_at(at), policy.plan_span(), GuardState::new(last));
            at.write(Self { mark, memory, plan, guards, state, inputs });
        }
        Ok(at)
    }

    /// What a call writes lies apart from what it reads, from the guards and from their plan.
    pub(crate) fn check_apart(
        &self,
        written: impl Iterator<Item = Span> + Clone,
        read: impl Iterator<Item = Span> + Clone,
    ) -> Result<(), SortieError> {
        apart(written.chain([self.memory]), read.chain([self.plan]))
    }
}
