//! RV32: from the first instruction to `main`, a counter of instructions, calls of the debugger.

use core::arch::{asm, global_asm};

/// Ticks of [`now`] count up to this, and from zero again.
pub(crate) const MOST_TICKS: u32 = u32::MAX;

// Faults have an address, the stack another, floating point is switched on where there is any, variables become zero.
global_asm!(
    ".section .init, \"ax\"",
    ".globl start",
    "start:",
    "la t0, 4f",
    "csrw mtvec, t0",
    "li t0, 0x2000",
    "csrs mstatus, t0",
    "la sp, __stack_top",
    "la t0, __bss_start",
    "la t1, __bss_end",
    "2: bgeu t0, t1, 3f",
    "sw zero, 0(t0)",
    "addi t0, t0, 4",
    "j 2b",
    "3: call {main}",
    // The address of a fault's code is a multiple of four.
    ".balign 4",
    "4: j {fault}",
    ".text",
    fault = sym fault,
    main = sym enter,
);

#[unsafe(link_section = ".harness")]
extern "C" fn enter() -> ! {
    crate::start()
}

#[unsafe(link_section = ".harness")]
extern "C" fn fault() -> ! {
    crate::console::fail(b"a fault of the processor\n\0")
}

/// Lets [`now`] count, which it always does.
#[inline(always)]
pub(crate) fn start_counter() {}

/// Instructions so far.
#[inline(always)]
pub(crate) fn now() -> u32 {
    let count;
    // SAFETY: only reads.
    unsafe { asm!("csrr {}, minstret", out(reg) count, options(nomem, nostack)) };
    count
}

/// Asks the debugger, or the emulator in its place, by three instructions that stay together in one page.
#[inline(always)]
pub(crate) fn call(operation: usize, argument: usize) -> usize {
    let answer;
    // SAFETY: the debugger reads and writes what the argument names.
    unsafe {
        asm!(
            ".balign 16",
            ".option push",
            ".option norvc",
            "slli x0, x0, 0x1f",
            "ebreak",
            "srai x0, x0, 7",
            ".option pop",
            inlateout("a0") operation => answer, in("a1") argument, options(nostack),
        );
    }
    answer
}
