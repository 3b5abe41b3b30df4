//! What stands for a panic.

use core::panic::PanicInfo;

unsafe extern "C" {
    /// Exists nowhere: a program that can call it does not link.
    fn a_path_to_a_panic_is_left() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: never runs: there is no program with it.
    unsafe { a_path_to_a_panic_is_left() }
}
