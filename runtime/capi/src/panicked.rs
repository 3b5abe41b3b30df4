//! What a panic would call, where there is no `std`.

use core::panic::PanicInfo;

unsafe extern "C" {
    /// Exists nowhere. The optimiser removes every call of it, as no function of this library can panic; one that it could
    /// not remove is told by the linker of the program.
    fn sortie_panicked() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: takes nothing and does not return; a program without it does not link.
    unsafe { sortie_panicked() }
}
