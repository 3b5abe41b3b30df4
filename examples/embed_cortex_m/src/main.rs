//! A plan on a Cortex-M4F, and a loop that decides: no heap, no operating system. `embed_steps` is what it decides.
//!
//! `cargo run --release` plays five steps in QEMU.
#![no_std]
#![no_main]

use cortex_m::singleton;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use embed_steps::{ARENA, Arena};
use panic_halt as _;

#[entry]
fn main() -> ! {
    // In static memory. There is one `main`, so that nobody else has it.
    let arena = singleton!(: Arena = ARENA);
    // And where it prints, your motors are told.
    let is_done = embed_steps::run(arena, |decided| hprintln!("{}", decided));
    let end = if is_done { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE };
    debug::exit(end);
    // Behind a debugger or an emulator nobody comes here; a board waits for its next interrupt.
    loop {
        cortex_m::asm::wfi();
    }
}
