//! Recorded numbers: how many cases there are, then for each whether an episode begins and its numbers, all of 32 bits.

use zerocopy::IntoBytes;

use crate::file::File;

/// The file, behind what was read.
pub(crate) struct Numbers {
    file: File,
    /// Cases that are still to be read.
    left: u32,
}

impl Numbers {
    #[unsafe(link_section = ".harness")]
    pub(crate) fn open(file: File) -> Option<Self> {
        let mut left = 0_u32;
        file.read(left.as_mut_bytes())?;
        Some(Self { file, left })
    }

    /// Reads the next case, and forgets where an episode begins; false behind the last, nothing where the file ends.
    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    pub(crate) fn next(&mut self, numbers: &mut [f32], states: &mut [f32]) -> Option<bool> {
        if self.left == 0 {
            return Some(false);
        }
        self.left -= 1;
        let mut begins = 0_u32;
        self.file.read(begins.as_mut_bytes())?;
        self.file.read(numbers.as_mut_bytes())?;
        if begins != 0 {
            states.fill(0.0);
        }
        Some(true)
    }
}
