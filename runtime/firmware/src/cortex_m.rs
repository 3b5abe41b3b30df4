//! Cortex-M: from reset to `main`, a counter of instructions, calls of the debugger.

use core::arch::{asm, global_asm};

/// Ticks of [`now`] count up to this, and from zero again.
pub(crate) const MOST_TICKS: u32 = 0x00ff_ffff;

/// SysTick: control, reload value, current value.
const SYSTICK: *mut u32 = 0xe000_e010 as *mut u32;

unsafe extern "C" {
    static mut __data_start: u32;
    static mut __data_end: u32;
    static __data_source: u32;
    static mut __bss_start: u32;
    static mut __bss_end: u32;
}

// The stack, reset, then fourteen faults and interrupts, none of which is expected.
global_asm!(
    ".section .vectors, \"a\"",
    ".word __stack_top",
    ".word {reset}",
    ".rept 14",
    ".word {fault}",
    ".endr",
    ".text",
    reset = sym reset,
    fault = sym fault,
);

/// The first code: variables get their first values, the floating-point unit is switched on.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".harness")]
unsafe extern "C" fn reset() -> ! {
    // SAFETY: nothing runs yet; the linker script says where variables lie, in whole words.
    unsafe {
        let (mut to, mut from) = (&raw mut __data_start, &raw const __data_source);
        while to < &raw mut __data_end {
            to.write_volatile(from.read_volatile());
            (to, from) = (to.add(1), from.add(1));
        }
        let mut to = &raw mut __bss_start;
        while to < &raw mut __bss_end {
            to.write_volatile(0);
            to = to.add(1);
        }
        #[cfg(target_abi = "eabihf")]
        {
            let access = 0xe000_ed88 as *mut u32;
            access.write_volatile(access.read_volatile() | 0xf << 20);
            asm!("dsb", "isb");
        }
    }
    crate::start()
}

#[unsafe(link_section = ".harness")]
extern "C" fn fault() -> ! {
    crate::console::fail(b"a fault of the processor\n\0")
}

/// Lets [`now`] count.
#[inline(always)]
pub(crate) fn start_counter() {
    // SAFETY: every Cortex-M of these boards has the timer, and nobody else uses it.
    unsafe {
        SYSTICK.add(1).write_volatile(MOST_TICKS);
        SYSTICK.add(2).write_volatile(0);
        SYSTICK.write_volatile(0b101);
    }
}

/// Ticks, which instructions are a multiple of where the emulator gives each the same time.
#[inline(always)]
pub(crate) fn now() -> u32 {
    // SAFETY: as above. It counts down.
    MOST_TICKS - unsafe { SYSTICK.add(2).read_volatile() }
}

/// Asks the debugger, or the emulator in its place.
#[inline(always)]
pub(crate) fn call(operation: usize, argument: usize) -> usize {
    let answer;
    // SAFETY: the debugger reads and writes what the argument names.
    unsafe {
        asm!("bkpt 0xab", inlateout("r0") operation => answer, in("r1") argument, options(nostack))
    };
    answer
}
