//! A plan's guards and what they remember of one robot, in memory of the caller.

use core::slice;

use sortie_core::plan::{GuardError, GuardState, Guards};

use crate::border::{Array, Span, apart};
use crate::errors::SortieError;
use crate::policy::SortiePolicy;

/// The guards of a plan, and what they remember of one robot. They live in the memory that was given to `sortie_guard`, and
/// end with it. One thread at a time uses them.
pub struct SortieGuards {
    mark: usize,
    memory: Span,
    pub(crate) guards: Guards<'static>,
    pub(crate) state: GuardState<&'static mut [f32]>,
    /// Numbers of all inputs.
    pub(crate) inputs: usize,
}

/// Tells guards from other memory, and from those that were moved.
fn mark(guards: *const SortieGuards) -> usize {
    u32::from_le_bytes(*b"GRDS") as usize ^ guards.addr()
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
        let before = memory.start().addr().wrapping_neg() % align_of::<Self>();
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
            at.write(Self { mark: mark(at), memory, guards, state: GuardState::new(last), inputs });
        }
        Ok(at)
    }

    /// The guards that a pointer leads to.
    ///
    /// # Safety
    /// Null, or so many bytes can be read there; nobody else uses the guards meanwhile.
    pub(crate) unsafe fn at_mut<'a>(guards: *mut Self) -> Result<&'a mut Self, SortieError> {
        if guards.is_null() {
            return Err(SortieError::Null);
        }
        if !guards.is_aligned() {
            return Err(SortieError::NoGuards);
        }
        // SAFETY: the address is aligned; the caller promises the bytes, and a number may have any bits.
        let found = unsafe { (&raw const (*guards).mark).read() };
        if found != mark(guards) {
            return Err(SortieError::NoGuards);
        }
        // SAFETY: the mark says that `place` wrote guards at this address.
        Ok(unsafe { &mut *guards })
    }

    /// What a call writes lies apart from what it reads, and from the guards.
    pub(crate) fn check_apart(
        &self,
        written: impl Iterator<Item = Span> + Clone,
        read: impl Iterator<Item = Span> + Clone,
    ) -> Result<(), SortieError> {
        apart(written.chain([self.memory]), read)
    }
}

impl From<GuardError> for SortieError {
    fn from(error: GuardError) -> Self {
        match error {
            GuardError::Plan(error) => error.into(),
            GuardError::Damaged => Self::Damaged,
            GuardError::Version { .. } => Self::Version,
            _ => Self::Inconsistent,
        }
    }
}
