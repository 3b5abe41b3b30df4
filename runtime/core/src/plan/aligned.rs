//! Bytes on the heap that start where weights and arenas must.

use alloc::vec;
use alloc::vec::Vec;

use super::ALIGNMENT;

/// A heap buffer that starts at a multiple of [`ALIGNMENT`]: for plans read from files, and for arenas.
#[derive(Debug)]
pub struct AlignedBytes {
    storage: Vec<u8>,
    start: usize,
}

impl AlignedBytes {
    /// A buffer of zeros.
    pub fn zeroed(len: usize) -> Self {
        let storage = vec![0; len.saturating_add(ALIGNMENT)];
        let start = storage.as_ptr().addr().wrapping_neg() % ALIGNMENT;
        let mut bytes = Self { storage, start };
        bytes.storage.truncate(start + len);
        bytes
    }

    /// A copy of `bytes`.
    pub fn copy_of(bytes: &[u8]) -> Self {
        let mut copy = Self::zeroed(bytes.len());
        copy.as_mut_slice().copy_from_slice(bytes);
        copy
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        self.storage.get(self.start..).unwrap_or(&[])
    }

    /// The bytes, to be written.
    pub fn as_mut_slice(&mut self) -> &mut [u8] {
        self.storage.get_mut(self.start..).unwrap_or(&mut [])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_aligned_and_holds_what_it_was_given() {
        for len in [0, 1, 63, 64, 1000] {
            let bytes = AlignedBytes::copy_of(&vec![7; len]);
            assert_eq!(bytes.as_slice(), vec![7; len]);
            assert_eq!(bytes.as_slice().as_ptr().addr() % ALIGNMENT, 0);
        }
    }
}
