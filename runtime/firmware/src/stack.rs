//! How deep the stack became: what lies below it is painted, and looked at afterwards.

use core::arch::asm;

const PAINT: u32 = 0x5ac7_57ac;
/// Bytes that are painted at most.
const DEEPEST: usize = 64 * 1024;
/// Bytes below the stack pointer that the painting itself may need.
const OWN: usize = 128;

unsafe extern "C" {
    static __bss_end: u32;
}

/// The lowest word that is painted.
#[inline(always)]
fn lowest(base: usize) -> usize {
    (&raw const __bss_end).addr().max(base.saturating_sub(DEEPEST)) & !3
}

/// Paints what lies below the stack.
#[unsafe(link_section = ".harness")]
#[inline(never)]
pub(crate) fn paint(base: usize) {
    let end = stack_pointer().saturating_sub(OWN);
    let mut at = lowest(base);
    while at < end {
        // SAFETY: between the variables and the stack nothing lies.
        unsafe { core::ptr::with_exposed_provenance_mut::<u32>(at).write_volatile(PAINT) };
        at += 4;
    }
}

/// Bytes below `base` that were written since.
#[unsafe(link_section = ".harness")]
#[inline(never)]
pub(crate) fn used(base: usize) -> usize {
    let mut at = lowest(base);
    // SAFETY: as above; only reads.
    while at < base
        && unsafe { core::ptr::with_exposed_provenance::<u32>(at).read_volatile() } == PAINT
    {
        at += 4;
    }
    base - at
}

/// Where the stack stands.
#[inline(always)]
pub(crate) fn stack_pointer() -> usize {
    let at;
    // SAFETY: only reads.
    #[cfg(any(target_arch = "aarch64", target_arch = "arm"))]
    unsafe {
        asm!("mov {}, sp", out(reg) at, options(nomem, nostack, preserves_flags));
    }
    // SAFETY: likewise.
    #[cfg(target_arch = "riscv32")]
    unsafe {
        asm!("mv {}, sp", out(reg) at, options(nomem, nostack, preserves_flags));
    }
    at
}
