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

/// Runs exactly 100,000 instructions, but for one or two.
#[inline(always)]
pub(crate) fn run_instructions() {
    // SAFETY: counts in one register.
    unsafe {
        asm!(
            "2:", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "nop", "addi {left}, {left}, -1", "bnez {left}, 2b",
            left = inout(reg) 10_000 => _, options(nomem, nostack),
        );
    }
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

/// Where the stack stands.
#[inline(always)]
pub(crate) fn stack_pointer() -> usize {
    let at;
    // SAFETY: only reads.
    unsafe { asm!("mv {}, sp", out(reg) at, options(nomem, nostack, preserves_flags)) };
    at
}
