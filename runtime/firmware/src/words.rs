//! Numbers of 32 bits in files that the program is built around.

/// A number, little-endian; zero behind the last.
pub(crate) const fn word(bytes: &[u8], index: usize) -> u32 {
    let Some((_, rest)) = bytes.split_at_checked(4 * index) else { return 0 };
    let Some(word) = rest.first_chunk::<4>() else { return 0 };
    u32::from_le_bytes(*word)
}
