//! The floor of a decision: a program that only brings the plan's weights near, once.

use sortie_core::plan::AlignedBytes;

/// Bytes that memory hands over at once.
const CACHE_LINE: usize = 64;
/// Lines read side by side, so that one addition need not wait for the last.
const LANES: usize = 16;

/// The bytes of a plan's weights, aligned as in the plan.
pub(super) struct Floor(AlignedBytes);

impl Floor {
    pub(super) fn new(weights: &[u8]) -> Self {
        Self(AlignedBytes::copy_of(weights))
    }

    /// Reads one word of every cache line: no arithmetic could need less.
    pub(super) fn read(&self) {
        std::hint::black_box(self.sum());
    }

    fn sum(&self) -> u64 {
        let mut sums = [0_u64; LANES];
        for lines in self.0.as_slice().as_chunks::<CACHE_LINE>().0.chunks(LANES) {
            for (sum, line) in sums.iter_mut().zip(lines) {
                let word = line.first_chunk().map_or(0, |word| u64::from_le_bytes(*word));
                *sum = sum.wrapping_add(word);
            }
        }
        sums.iter().fold(0, |total, sum| total.wrapping_add(*sum))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cache_line_is_read() {
        let lines = 0..LANES as u64 * 3 + 1;
        let words = lines.clone().flat_map(|line| [line * line, 9, 9, 9, 9, 9, 9, 9]);
        let bytes: Vec<u8> = words.flat_map(u64::to_le_bytes).collect();
        let want: u64 = lines.map(|line| line * line).sum();
        assert_eq!(Floor::new(&bytes).sum(), want);
    }
}
