//! A file of the machine that runs the emulator, which reads it as a debugger would.

use crate::machine::call;

const OPEN: usize = 0x01;
const READ: usize = 0x06;
const LENGTH: usize = 0x0c;

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

    /// Bytes of the file.
    #[allow(dead_code, reason = "a plan that is inside a program has a length")]
    #[unsafe(link_section = ".harness")]
    pub(crate) fn length(&self) -> Option<usize> {
        let block = [self.0];
        let length = call(LENGTH, block.as_ptr().addr());
        (length != usize::MAX).then_some(length)
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
