//! The floor of a decision: a program that only reads the plan's weights, once.

/// Words read side by side, so that one addition need not wait for the last.
const LANES: usize = 16;

/// The bytes of a plan's weights as whole words.
pub(super) struct Floor {
    words: Vec<[u64; LANES]>,
}

impl Floor {
    pub(super) fn new(weights: &[u8]) -> Self {
        let words = weights.as_chunks::<8>().0.iter().map(|bytes| u64::from_le_bytes(*bytes));
        let words: Vec<u64> = words.collect();
        Self { words: words.as_chunks().0.to_vec() }
    }

    /// Reads everything.
    pub(super) fn read(&self) {
        std::hint::black_box(self.sum());
    }

    fn sum(&self) -> u64 {
        let mut sums = [0_u64; LANES];
        for words in &self.words {
            for (sum, word) in sums.iter_mut().zip(words) {
                *sum = sum.wrapping_add(*word);
            }
        }
        sums.iter().fold(0, |total, sum| total.wrapping_add(*sum))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_is_read() {
        let bytes: Vec<u8> =
            (0..LANES as u64 * 3).flat_map(|word| (word * word).to_le_bytes()).collect();
        let want: u64 = (0..LANES as u64 * 3).map(|word| word * word).sum();
        assert_eq!(Floor::new(&bytes).sum(), want);
    }
}
