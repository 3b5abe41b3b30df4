//! A known number of instructions, by which the counter's ticks become instructions.

use core::arch::asm;

/// Runs exactly 100,000 instructions, but for one or two.
#[inline(always)]
pub(crate) fn run_instructions() {
    // SAFETY: counts in one register.
    #[cfg(target_arch = "arm")]
    unsafe {
        asm!(
            "2:", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "subs {left}, {left}, #1", "bne 2b",
            left = inout(reg) 10_000 => _, options(nomem, nostack),
        );
    }
    // SAFETY: likewise.
    #[cfg(target_arch = "aarch64")]
    unsafe {
        asm!(
            "2:", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "subs {left:w}, {left:w}, #1", "b.ne 2b",
            left = inout(reg) 10_000 => _, options(nomem, nostack),
        );
    }
    // SAFETY: likewise.
    #[cfg(target_arch = "riscv32")]
    unsafe {
        asm!(
            "2:", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "addi {left}, {left}, -1", "bnez {left}, 2b",
            left = inout(reg) 10_000 => _, options(nomem, nostack),
        );
    }
}
