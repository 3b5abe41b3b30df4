//! The UART of the board `virt` of AArch64.

/// Data, then state, line and control among registers of four bytes.
const REGISTERS: *mut u32 = 0x0900_0000 as *mut u32;
const STATE: usize = 6;
const LINE: usize = 11;
const CONTROL: usize = 12;

/// Bits of the state.
const IS_EMPTY: u32 = 1 << 4;
const IS_FULL: u32 = 1 << 5;

pub(crate) fn start() {
    // SAFETY: every such board has it there, and nobody else uses it. Bytes of eight bits, queues, both directions.
    unsafe {
        REGISTERS.add(LINE).write_volatile(0x70);
        REGISTERS.add(CONTROL).write_volatile(0x301);
    }
}

fn state() -> u32 {
    // SAFETY: as above; only reads.
    unsafe { REGISTERS.add(STATE).read_volatile() }
}

/// Whether a byte has come.
pub(crate) fn holds_byte() -> bool {
    state() & IS_EMPTY == 0
}

/// Takes the byte that has come.
pub(crate) fn take() -> u8 {
    // SAFETY: as above.
    unsafe { REGISTERS.read_volatile() as u8 }
}

/// Sends a byte, once there is room for it.
pub(crate) fn send(byte: u8) {
    while state() & IS_FULL != 0 {}
    // SAFETY: as above.
    unsafe { REGISTERS.write_volatile(byte.into()) }
}
