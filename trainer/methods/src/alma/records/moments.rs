//! States with what was decided and done in them, each stored once.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use sortie_envs::{Spec, UNASSIGNED};

use crate::alma::agents::NO_ACTION;

/// Moments that are stored, and forgotten, together.
const BLOCK: u64 = 1024;
/// Bytes that say how long a state is.
const LENGTH: usize = 4;

/// The newest moments of a run by their numbers, which only grow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    agents: usize,
    state_bytes: usize,
    /// Number of the first block that is kept.
    first: u64,
    /// A moment is its state's length, the state and zeros, then of every agent subtask, last action and action.
    blocks: VecDeque<Vec<u8>>,
    /// The number of the next moment.
    next: u64,
}

/// A state in which a team acted, or one that an episode ran out of time in.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// The state.
    pub state: &'a [u8],
    /// `[A]`: the subtask of every agent, [`UNASSIGNED`] where there is none.
    pub allocation: &'a [u8],
    /// `[A]`: what every agent had done before.
    pub last_actions: &'a [u8],
    /// `[A]`: what every agent did.
    pub actions: &'a [u8],
}

impl Moments {
    /// None yet, of an environment.
    pub fn new(spec: &Spec) -> Self {
        let (agents, state_bytes) = (spec.shape.agents, spec.state_bytes);
        Self { agents, state_bytes, first: 0, blocks: VecDeque::new(), next: 0 }
    }

    /// Adds a moment in which nobody is allocated and nothing is done yet; returns its number.
    pub fn push(&mut self, state: &[u8], last_actions: &[u8]) -> u64 {
        let bytes = self.bytes();
        if self.next == (self.first + self.blocks.len() as u64) * BLOCK {
            self.blocks.push_back(Vec::with_capacity(BLOCK as usize * bytes));
        }
        let (number, padding) = (self.next, self.state_bytes - state.len());
        self.next += 1;
        if let Some(block) = self.blocks.back_mut() {
            block.extend((state.len() as u32).to_le_bytes());
            block.extend(state);
            block.extend(std::iter::repeat_n(0, padding));
            block.extend(std::iter::repeat_n(UNASSIGNED, self.agents));
            block.extend(&last_actions[..self.agents]);
            block.extend(std::iter::repeat_n(NO_ACTION, self.agents));
        }
        number
    }

    /// Says what the agents of a moment were allocated to, those that exist.
    pub fn allocate(&mut self, number: u64, allocation: &[u8]) {
        self.part(number, 0)[..allocation.len()].copy_from_slice(allocation);
    }

    /// Says what the agents of a moment did.
    pub fn act(&mut self, number: u64, actions: &[u16]) {
        let part = self.part(number, 2).iter_mut();
        part.zip(actions).for_each(|(kept, action)| *kept = *action as u8);
    }

    /// A moment that is not forgotten.
    #[inline]
    pub fn get(&self, number: u64) -> Moment<'_> {
        let bytes = self.bytes();
        let moment = &self.blocks[self.block(number)][place(number) * bytes..][..bytes];
        let (length, rest) = moment.split_at(LENGTH);
        let (state, rest) = rest.split_at(self.state_bytes);
        let (allocation, rest) = rest.split_at(self.agents);
        let (last_actions, actions) = rest.split_at(self.agents);
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]);
        Moment { state: &state[..length as usize], allocation, last_actions, actions }
    }

    /// Reads a little of a moment, so that it is on its way from memory.
    #[inline]
    pub fn fetch(&self, number: u64) -> u8 {
        const CACHE_LINE: usize = 64;
        let bytes = self.bytes();
        let moment = &self.blocks[self.block(number)][place(number) * bytes..][..bytes];
        moment.iter().step_by(CACHE_LINE).fold(0, |sum, byte| sum ^ byte)
    }

    /// The number that the next moment gets.
    pub fn next(&self) -> u64 {
        self.next
    }

    /// Forgets moments of smaller numbers, though not all at once.
    pub fn forget_before(&mut self, number: u64) {
        while self.blocks.len() > 1 && (self.first + 1) * BLOCK <= number {
            self.blocks.pop_front();
            self.first += 1;
        }
    }

    /// Whether these are moments of an environment, all that should be there, as they are from a sound file.
    pub fn fits(&self, spec: &Spec) -> bool {
        let kept = self.next.checked_sub(self.first.saturating_mul(BLOCK));
        let lengths = || self.blocks.iter().map(Vec::len);
        let whole = BLOCK as usize * self.bytes();
        (self.agents, self.state_bytes) == (spec.shape.agents, spec.state_bytes)
            && kept
                .is_some_and(|kept| lengths().sum::<usize>() as u64 == kept * self.bytes() as u64)
            && lengths().rev().skip(1).all(|length| length == whole)
            && self.blocks.back().is_none_or(|last| last.len() <= whole)
    }

    /// Whether a moment is there.
    pub fn has(&self, number: u64) -> bool {
        (self.first * BLOCK..self.next).contains(&number)
    }

    fn bytes(&self) -> usize {
        LENGTH + self.state_bytes + 3 * self.agents
    }

    fn block(&self, number: u64) -> usize {
        (number / BLOCK - self.first) as usize
    }

    /// One of the three parts of a moment that are about its agents.
    fn part(&mut self, number: u64, part: usize) -> &mut [u8] {
        let (bytes, block) = (self.bytes(), self.block(number));
        let first = place(number) * bytes + LENGTH + self.state_bytes + part * self.agents;
        &mut self.blocks[block][first..][..self.agents]
    }
}

/// The place of a moment in its block.
fn place(number: u64) -> usize {
    (number % BLOCK) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_envs::Shape;

    fn spec() -> Spec {
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        Spec { shape, state_bytes: 6, ..Spec::default() }
    }

    fn state(number: u64) -> Vec<u8> {
        vec![number as u8; 3 + (number % 4) as usize]
    }

    #[test]
    fn moments_are_what_was_said_of_them_and_old_ones_are_forgotten() {
        let mut moments = Moments::new(&spec());
        assert!(moments.fits(&spec()) && !moments.has(0));
        for number in 0..5000 {
            assert_eq!(moments.push(&state(number), &[number as u8, 3]), number);
            if number % 3 == 0 {
                moments.allocate(number, &[0, 1]);
                moments.act(number, &[2, number as u16 % 4]);
            }
        }
        moments.forget_before(2047);
        assert!(moments.has(1024) && !moments.has(1023), "what shares a block stays");
        for number in [1024, 2048, 3003, 4999] {
            let moment = moments.get(number);
            assert_eq!(moment.state, state(number));
            assert_eq!(moment.last_actions, [number as u8, 3]);
            let (allocation, actions) = match number % 3 {
                0 => ([0, 1], [2, (number % 4) as u8]),
                _ => ([UNASSIGNED; 2], [NO_ACTION; 2]),
            };
            assert_eq!((moment.allocation, moment.actions), (&allocation[..], &actions[..]));
        }
        assert!(moments.fits(&spec()));
        moments.forget_before(u64::MAX);
        assert!(moments.has(4999) && moments.fits(&spec()), "the running block stays");
    }

    #[test]
    fn moments_of_a_file_fit_only_where_all_of_them_do() {
        let mut moments = Moments::new(&spec());
        for number in 0..1500 {
            moments.push(&state(number), &[0; 2]);
        }
        assert!(!moments.fits(&Spec { state_bytes: 7, ..spec() }));
        let broken: [fn(&mut Moments); 4] = [
            |moments| moments.next += 1,
            |moments| moments.first = 2,
            |moments| moments.blocks[0].truncate(5),
            |moments| moments.blocks.swap(0, 1),
        ];
        for change in broken {
            let mut changed = moments.clone();
            change(&mut changed);
            assert!(!changed.fits(&spec()));
        }
    }
}
