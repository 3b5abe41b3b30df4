//! The available actions of an agent as bits.

use crate::limits;

/// A set of actions.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ActionMask([u64; limits::ACTIONS / 64]);

impl ActionMask {
    /// The actions whose availability code is not 0.
    pub(super) fn of(available: &[u16]) -> Self {
        let mut mask = Self::default();
        for (word, codes) in mask.0.iter_mut().zip(available.chunks(64)) {
            for (bit, code) in codes.iter().enumerate() {
                *word |= u64::from(*code != 0) << bit;
            }
        }
        mask
    }

    /// Whether `action` is available.
    pub(super) fn contains(&self, action: u16) -> bool {
        let (word, bit) = (usize::from(action / 64), action % 64);
        self.0.get(word).is_some_and(|word| word >> bit & 1 == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contains_what_is_available() {
        let mut codes = [0; limits::ACTIONS];
        for action in [0, 63, 64, 255] {
            codes[action] = 3;
        }
        let mask = ActionMask::of(&codes);
        let contained = (0..=u16::MAX).filter(|&action| mask.contains(action));
        assert!(contained.eq([0, 63, 64, 255]));
    }
}
