//! A set of entities as bits.

use crate::limits::ENTITIES;

const WORDS: usize = ENTITIES / 64;

/// A set of entities; a set bit means present, or visible, as its use says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EntityMask {
    words: [u64; WORDS],
}

impl EntityMask {
    /// The set without any entity.
    pub const EMPTY: Self = Self { words: [0; WORDS] };

    /// Builds the set from words of 64 entities each; missing words are empty, further ones ignored.
    pub fn from_words(words: &[u64]) -> Self {
        let mut mask = Self::EMPTY;
        for (to, from) in mask.words.iter_mut().zip(words) {
            *to = *from;
        }
        mask
    }

    /// The words of 64 entities each, entity 0 in the lowest bit of the first.
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// The set of the first `count` entities, all of them where `count` exceeds the limit.
    pub fn first(count: usize) -> Self {
        let mut mask = Self::EMPTY;
        for entity in 0..count.min(ENTITIES) {
            mask.insert(entity);
        }
        mask
    }

    /// Whether `entity` is in the set; an entity beyond the limit never is.
    pub fn contains(&self, entity: usize) -> bool {
        self.words.get(entity / 64).is_some_and(|word| word >> (entity % 64) & 1 == 1)
    }

    /// Adds `entity`; one beyond the limit is ignored.
    pub fn insert(&mut self, entity: usize) {
        if let Some(word) = self.words.get_mut(entity / 64) {
            *word |= 1 << (entity % 64);
        }
    }

    /// Removes `entity`.
    pub fn remove(&mut self, entity: usize) {
        if let Some(word) = self.words.get_mut(entity / 64) {
            *word &= !(1 << (entity % 64));
        }
    }

    /// The entities in both sets.
    pub fn and(&self, other: &Self) -> Self {
        let mut mask = *self;
        for (word, with) in mask.words.iter_mut().zip(other.words) {
            *word &= with;
        }
        mask
    }

    /// The entities of this set that are not in the other.
    pub fn without(&self, other: &Self) -> Self {
        let mut mask = *self;
        for (word, with) in mask.words.iter_mut().zip(other.words) {
            *word &= !with;
        }
        mask
    }

    /// The entities in either set.
    pub fn or(&self, other: &Self) -> Self {
        let mut mask = *self;
        for (word, with) in mask.words.iter_mut().zip(other.words) {
            *word |= with;
        }
        mask
    }

    /// Number of entities in the set.
    pub fn len(&self) -> usize {
        self.words.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Whether no entity is in the set.
    pub fn is_empty(&self) -> bool {
        *self == Self::EMPTY
    }

    /// The entities in rising order.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().flat_map(|(index, &word)| {
            let mut rest = word;
            core::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(index * 64 + bit)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_entities_of_every_word_in_order() {
        let mut mask = EntityMask::EMPTY;
        for entity in [127, 0, 64, 63] {
            mask.insert(entity);
        }
        mask.remove(64);
        assert!(mask.iter().eq([0, 63, 127]));
        assert_eq!(mask.len(), 3);
    }

    #[test]
    fn ignores_entities_beyond_the_limit() {
        let mut mask = EntityMask::first(ENTITIES + 5);
        assert_eq!(mask.len(), ENTITIES);
        mask.insert(ENTITIES);
        assert!(!mask.contains(ENTITIES));
    }
}
