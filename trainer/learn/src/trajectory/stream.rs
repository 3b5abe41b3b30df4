//! The states of one instance, in blocks that are used again.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::{End, Widths};

/// States that are stored, and forgotten, together.
pub(super) const BLOCK: u64 = 256;

/// The states of one instance.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(bound(deserialize = "N: Deserialize<'de>"))]
pub(super) struct Stream<N> {
    pub(super) blocks: VecDeque<Block<N>>,
    /// Number of the first state in the first block.
    pub(super) first: u64,
    /// Number of the first state that is kept.
    pub(super) kept_from: u64,
    /// The number that the next state gets.
    pub(super) next: u64,
    /// Number of the first state of the running episode.
    pub(super) running: u64,
    /// Blocks to be used again.
    #[serde(skip)]
    pub(super) spare: Vec<Block<N>>,
}

/// Some states of one instance, one behind the other.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Block<N> {
    pub(super) states: Vec<Stored<N>>,
    pub(super) bytes: Vec<u8>,
    pub(super) actions: Vec<u16>,
    /// Of every state the team's, then those of subtasks and agents.
    pub(super) rewards: Vec<f32>,
}

/// What stands together of a state, as a draw out of many millions waits for memory.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Stored<N> {
    /// Where its bytes end.
    pub(super) bytes_end: u32,
    pub(super) end: End,
    pub(super) note: N,
}

impl<N: Clone + Default> Stream<N> {
    /// Adds a state; returns its block, in which all else about it is to follow.
    pub(super) fn write(
        &mut self,
        state: &[u8],
        end: End,
        note: N,
        widths: Widths,
    ) -> &mut Block<N> {
        if self.next == self.first + self.blocks.len() as u64 * BLOCK {
            let mut block = self.spare.pop().unwrap_or_default();
            block.clear();
            block.reserve(widths);
            self.blocks.push_back(block);
        }
        self.next += 1;
        let block = self.blocks.back_mut().expect("a block with room");
        block.bytes.extend_from_slice(state);
        block.states.push(Stored { bytes_end: block.bytes.len() as u32, end, note });
        block
    }

    /// Forgets all states of smaller numbers.
    pub(super) fn forget_before(&mut self, number: u64) {
        self.kept_from = self.kept_from.max(number);
        while self.first + BLOCK <= self.kept_from {
            self.spare.extend(self.blocks.pop_front());
            self.first += BLOCK;
        }
    }
}

impl<N> Block<N> {
    fn clear(&mut self) {
        self.states.clear();
        self.bytes.clear();
        self.actions.clear();
        self.rewards.clear();
    }

    /// Makes room for all that is to come but the bytes of states, whose number is not known.
    fn reserve(&mut self, widths: Widths) {
        let states = BLOCK as usize;
        self.actions.reserve_exact(states * widths.agents);
        self.rewards.reserve_exact(states * widths.rewards());
        self.states.reserve_exact(states);
    }
}
