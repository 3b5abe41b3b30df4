//! What a debugger does for a program, or the emulator in its place: shows text, reads a file, ends the program.

use crate::machine::call;

const OPEN: usize = 0x01;
const WRITE: usize = 0x04;
const READ: usize = 0x06;
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

/// A file of the machine that runs the emulator.
pub(crate) struct File(usize);

impl File {
    /// Opens a file for reading. The name ends with a zero.
    #[unsafe(link_section = ".harness")]
    pub(crate) fn open(name: &[u8]) -> Option<Self> {
        /// `rb`
        const MODE: usize = 1;
        let block = [name.as_ptr().addr(), MODE, name.len().saturating_sub(1)];
        let handle = call(OPEN, block.as_ptr().addr());
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Fills `bytes`; nothing where the file ends before.
    #[unsafe(link_section = ".harness")]
    pub(crate) fn read(&self, bytes: &mut [u8]) -> Option<()> {
        if bytes.is_empty() {
            return Some(());
        }
        let block = [self.0, bytes.as_mut_ptr().expose_provenance(), bytes.len()];
        let missing = call(READ, block.as_ptr().addr());
        (missing == 0).then_some(())
    }
}
