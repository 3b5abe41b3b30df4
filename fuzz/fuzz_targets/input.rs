//! Takes numbers from a fuzzer's bytes; zeros where they end.

/// What is left of an input.
pub struct Input<'a>(pub &'a [u8]);

#[allow(dead_code, reason = "not every target takes every kind of number")]
impl<'a> Input<'a> {
    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let [byte] = self.array();
        byte
    }

    /// A number from 0 to `most`.
    pub fn up_to(&mut self, most: usize) -> usize {
        usize::from(u16::from_le_bytes(self.array())) % (most + 1)
    }

    /// Any 64 bits.
    pub fn word(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    /// Any f32: a small one, zero, or any bits.
    pub fn float(&mut self) -> f32 {
        match self.byte() {
            0..=63 => 0.0,
            64..=79 => f32::from_le_bytes(self.array()),
            byte => (f32::from(byte) - 160.0) / 32.0,
        }
    }

    /// The next bytes, as many as there are up to `len`.
    pub fn bytes(&mut self, len: usize) -> &'a [u8] {
        let (bytes, rest) = self.0.split_at(len.min(self.0.len()));
        self.0 = rest;
        bytes
    }

    fn array<const LEN: usize>(&mut self) -> [u8; LEN] {
        let mut array = [0; LEN];
        let bytes = self.bytes(LEN);
        array[..bytes.len()].copy_from_slice(bytes);
        array
    }
}
