//! The first UART of the boards `mps2`.

/// Data, state, control, interrupts, divisor of the clock.
const REGISTERS: *mut u32 = 0x4000_4000 as *mut u32;

/// Bits of the state.
const SENDS: u32 = 0b01;
const HOLDS: u32 = 0b10;

pub(crate) fn start() {
    // SAFETY: every board `mps2` has it there, and nobody else uses it.
    unsafe {
        // The least divisor of 25 MHz.
        REGISTERS.add(4).write_volatile(16);
        REGISTERS.add(2).write_volatile(0b11);
    }
}

fn state() -> u32 {
    // SAFETY: as above; only reads.
    unsafe { REGISTERS.add(1).read_volatile() }
}

/// Whether a byte has come.
pub(crate) fn holds_byte() -> bool {
    state() & HOLDS != 0
}

/// Takes the byte that has come.
pub(crate) fn take() -> u8 {
    // SAFETY: as above.
    unsafe { REGISTERS.read_volatile() as u8 }
}

/// Sends a byte, once there is room for it.
pub(crate) fn send(byte: u8) {
    while state() & SENDS != 0 {}
    // SAFETY: as above.
    unsafe { REGISTERS.write_volatile(byte.into()) }
}
