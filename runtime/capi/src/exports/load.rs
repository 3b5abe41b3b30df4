//! From the bytes of a plan to a policy.

use core::ffi::c_void;
use core::ptr;

use crate::border::{Array, Span, apart};
use crate::errors::SortieError;
use crate::policy::{self, SortiePolicy};

/// Bytes that a policy takes beside its arena and the places of its inputs and outputs. See `SORTIE_MEMORY_BYTES`.
pub const SORTIE_POLICY_BYTES: usize = 640;

/// Rounding up to the arena, and to the first aligned byte.
const _: () = assert!(size_of::<SortiePolicy>() + 64 + 64 <= SORTIE_POLICY_BYTES);
const _: () = assert!(size_of::<&[f32]>() <= 16);

/// Checks a plan and writes how many bytes of memory its policy needs, wherever they start; 0 where that fails.
/// A program that knows its plan can say so before it runs: `SORTIE_MEMORY_BYTES`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_memory_bytes(
    plan: *const c_void,
    plan_bytes: usize,
    bytes: *mut usize,
) -> SortieError {
    let needed = || {
        let (plan, to) = (plan_of(plan, plan_bytes), Array::of(bytes, 1, 1)?);
        apart([to.span()].into_iter(), [span_of(&plan)].into_iter())?;
        // SAFETY: apart from the plan; the caller promises the memory.
        let to = unsafe { to.write() };
        to.fill(0);
        // SAFETY: as above.
        let plan = policy::load(unsafe { plan?.read() })?;
        to.fill(policy::memory_bytes(&plan)?);
        Ok(())
    };
    needed().into()
}

/// Loads a plan: checks all of it once, and lays the policy into the memory that is given. Nothing is copied or
/// allocated: the plan's bytes, which start at a multiple of 64 (`SORTIE_ALIGNED`), and the memory, which may start
/// anywhere, stay as long as the policy is used, and nobody writes them. `*policy` is NULL where that fails; a policy
/// that was in the memory before is then still there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_load(
    plan: *const c_void,
    plan_bytes: usize,
    memory: *mut c_void,
    memory_bytes: usize,
    policy: *mut *mut SortiePolicy,
) -> SortieError {
    let load = || {
        let to = Array::of(policy, 1, 1)?;
        let plan = plan_of(plan, plan_bytes);
        let memory = Array::<u8>::of(memory.cast(), memory_bytes, memory_bytes);
        apart([to.span()].into_iter(), [span_of(&plan), span_of(&memory)].into_iter())?;
        // SAFETY: apart from plan and memory; the caller promises that it can be written.
        let to = unsafe { to.write() };
        to.fill(ptr::null_mut());
        // SAFETY: as the caller promises, as long as the policy is used.
        to.fill(unsafe { SortiePolicy::place(plan?, memory?) }?);
        Ok(())
    };
    load().into()
}

/// The bytes of a plan, without which there is nothing to be checked.
fn plan_of(plan: *const c_void, bytes: usize) -> Result<Array<u8>, SortieError> {
    if plan.is_null() {
        return Err(SortieError::Null);
    }
    Array::of(plan.cast(), bytes, bytes)
}

fn span_of(bytes: &Result<Array<u8>, SortieError>) -> Span {
    bytes.as_ref().map_or(Span::EMPTY, |bytes| bytes.span())
}
