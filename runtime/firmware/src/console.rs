//! What a debugger does for a program, or the emulator in its place: shows text, ends the program.

use crate::machine::call;

const WRITE: usize = 0x04;
const END: usize = 0x20;

/// `ADP_Stopped_ApplicationExit`.
const ENDED: usize = 0x20026;

/// Ends the program.
#[unsafe(link_section = ".harness")]
pub(crate) fn end(code: usize) -> ! {
    let block = [ENDED, code];
    loop {
        call(END, block.as_ptr().addr());
    }
}

/// Says why, and ends the program as one that failed. The text ends with a zero.
#[unsafe(link_section = ".harness")]
pub(crate) fn fail(why: &[u8]) -> ! {
    call(WRITE, why.as_ptr().addr());
    end(3)
}

/// Prints a name and a number in hexadecimal digits, which take no division.
#[unsafe(link_section = ".harness")]
pub(crate) fn tell(name: &[u8], number: u64) {
    let digit = |place: u32| match (number >> (4 * place)) as u8 & 0xf {
        digit @ 0..=9 => b'0' + digit,
        digit => b'a' - 10 + digit,
    };
    let digits = (0..16).rev().map(digit);
    let line = name.iter().copied().chain([b' ']).chain(digits).chain([b'\n']);
    // The last byte stays zero.
    let mut text = [0; 64];
    if let Some((_, text)) = text.split_last_mut() {
        text.iter_mut().zip(line).for_each(|(to, from)| *to = from);
    }
    call(WRITE, text.as_ptr().addr());
}
