//! AArch64: from the first instruction to `main`, a counter of instructions, calls of the debugger.

use core::arch::{asm, global_asm};

/// Ticks of [`now`] count up to this, and from zero again.
pub(crate) const MOST_TICKS: u32 = u32::MAX;

// Vectors are switched on, faults have an address, the stack another, variables become zero.
global_asm!(
    ".section .init, \"ax\"",
    ".globl start",
    "start:",
    "mov x0, #(3 << 20)",
    "msr cpacr_el1, x0",
    "adr x0, 4f",
    "msr vbar_el1, x0",
    "isb",
    "ldr x0, =__stack_top",
    "mov sp, x0",
    "ldr x0, =__bss_start",
    "ldr x1, =__bss_end",
    "2: cmp x0, x1",
    "b.hs 3f",
    "str wzr, [x0], #4",
    "b 2b",
    "3: bl {main}",
    // Sixteen faults and interrupts, none of which is expected; their address is a multiple of 2,048.
    ".balign 2048",
    "4:",
    ".rept 16",
    ".balign 128",
    "b {fault}",
    ".endr",
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

/// Lets [`now`] count.
#[inline(always)]
pub(crate) fn start_counter() {
    // SAFETY: the counter of cycles is nobody else's: its own switch, then that of all counters, for 64 bits.
    unsafe {
        asm!("msr pmcntenset_el0, {}", in(reg) 1_u64 << 31, options(nomem, nostack));
        asm!("msr pmcr_el0, {}", in(reg) 0b100_0001_u64, options(nomem, nostack));
    }
}

/// Cycles so far: instructions, where the emulator gives each the same time.
#[inline(always)]
pub(crate) fn now() -> u32 {
    let count: u64;
    // SAFETY: only reads.
    unsafe { asm!("mrs {}, pmccntr_el0", out(reg) count, options(nomem, nostack)) };
    count as u32
}

/// Asks the debugger, or the emulator in its place.
#[inline(always)]
pub(crate) fn call(operation: usize, argument: usize) -> usize {
    let answer;
    // SAFETY: the debugger reads and writes what the argument names.
    unsafe {
        asm!("hlt 0xf000", inlateout("x0") operation => answer, in("x1") argument, options(nostack))
    };
    answer
}
