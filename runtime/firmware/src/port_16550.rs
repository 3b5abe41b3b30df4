//! The UART of the board `virt`.

/// Data, interrupts, queues, line, modem, state: registers of one byte.
const REGISTERS: *mut u8 = 0x1000_0000 as *mut u8;

/// Bits of the state.
const HOLDS: u8 = 1;
const IS_EMPTY: u8 = 1 << 5;

pub(crate) fn start() {
    // SAFETY: every board `virt` has it there, and nobody else uses it. The queues are switched on.
    unsafe { REGISTERS.add(2).write_volatile(1) }
}

fn state() -> u8 {
    // SAFETY: as above; only reads.
    unsafe { REGISTERS.add(5).read_volatile() }
}

/// Whether a byte has come.
pub(crate) fn holds_byte() -> bool {
    state() & HOLDS != 0
}

/// Takes the byte that has come.
pub(crate) fn take() -> u8 {
    // SAFETY: as above.
    unsafe { REGISTERS.read_volatile() }
}

/// Sends a byte, once there is room for it.
pub(crate) fn send(byte: u8) {
    while state() & IS_EMPTY == 0 {}
    // SAFETY: as above.
    unsafe { REGISTERS.write_volatile(byte) }
}
