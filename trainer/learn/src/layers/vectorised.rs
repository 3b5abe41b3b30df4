//! Loops compiled for the vector units that the processor has.
//!
//! The build itself is for any x86-64 processor. Wider vectors change no bit of a result: no sum is
//! reordered, and multiplications are not fused with additions.

use pulp::Arch;

/// Runs `work`, compiled for the widest of the known vector units.
///
/// What `work` calls must be inlined into it; other functions stay as they are.
#[inline(always)]
pub(crate) fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    Arch::new().dispatch(work)
}
