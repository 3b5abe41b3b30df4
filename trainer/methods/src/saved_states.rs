//! States one behind the other, as an environment wrote them.

use serde::{Deserialize, Serialize};

/// Any number of states; each has as many bytes as it needs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct SavedStates {
    bytes: Vec<u8>,
    /// Where each of them ends.
    ends: Vec<u32>,
}

impl SavedStates {
    /// Adds a state.
    pub(crate) fn push(&mut self, state: &[u8]) {
        self.bytes.extend_from_slice(state);
        self.ends.push(self.bytes.len() as u32);
    }

    /// The bytes of a state.
    pub(crate) fn at(&self, index: usize) -> &[u8] {
        let start = index.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.bytes[start as usize..self.ends[index] as usize]
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Gives back the memory that no state needs.
    pub(crate) fn shrink_to_fit(&mut self) {
        self.bytes.shrink_to_fit();
        self.ends.shrink_to_fit();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_of_any_length_come_back() {
        let mut states = SavedStates::default();
        let all = [&[1, 2, 3][..], &[], &[4], &[5, 6]];
        all.iter().for_each(|state| states.push(state));
        states.shrink_to_fit();
        assert_eq!(states.len(), 4);
        assert!((0..4).map(|index| states.at(index)).eq(all));
    }
}
