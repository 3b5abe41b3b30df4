//! What was seen: moments, which are states with what was decided and done in them, each stored once, and records that
//! refer to them. A record is a step of one team.
//!
//! Features are rebuilt when a record is used.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use sortie_envs::{AgentSet, EntitySet, Spec, UNASSIGNED};

use super::learner::Samples;
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

/// The rewards that the team of one step earned over the next steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Discounted sum of the team's rewards until the state to bootstrap from.
    pub reward: f32,
    /// Factor of the bootstrapped value; 0 where there is nothing to bootstrap from.
    pub discount: f32,
    /// The team's subtask when it acted, which is held fixed for the bootstrap.
    pub task: u8,
    /// How many moments later the one to bootstrap from is; 0 where there is none.
    ahead: u32,
    /// The moment in which the team acted.
    now: u64,
    /// The things in sight, in two halves.
    things: [u64; 2],
}

impl Record {
    /// A record of the team at a subtask in one moment and in a later one; `things` are in its sight.
    pub fn new(task: usize, [now, next]: [u64; 2], things: EntitySet) -> Self {
        let things = [things as u64, (things >> 64) as u64];
        let ahead = (next - now) as u32;
        Self { reward: 0.0, discount: 0.0, task: task as u8, ahead, now, things }
    }

    /// The things in sight.
    pub fn things(&self) -> EntitySet {
        EntitySet::from(self.things[0]) | EntitySet::from(self.things[1]) << 64
    }
}

/// A record with the moments that it is about.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    /// Rewards and discount.
    pub record: &'a Record,
    /// When the team acted.
    pub now: Moment<'a>,
    /// To bootstrap from; `now` once more where there is nothing to bootstrap from.
    pub next: Moment<'a>,
}

impl Sample<'_> {
    /// The agents that earned the reward.
    pub fn team(&self) -> AgentSet {
        let members = self.now.allocation.iter().enumerate();
        let members = members.filter(|(_, task)| **task == self.record.task);
        members.fold(0, |team, (agent, _)| team | 1 << agent)
    }
}

/// A ring of records: the newest replaces the oldest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    capacity: usize,
    /// How many moments old what a new record refers to may be.
    lag: u64,
    records: Vec<Record>,
    next: usize,
    pub(super) moments: Moments,
}

impl Replay {
    /// Room for `capacity` records of an environment, each of which refers to none but the last `lag` moments.
    pub fn new(capacity: usize, lag: u64, spec: &Spec) -> Self {
        let (records, moments) = (Vec::with_capacity(capacity), Moments::new(spec));
        Self { capacity, lag, records, next: 0, moments }
    }

    /// Stores a record, and forgets moments that no record refers to any more, nor will.
    ///
    /// # Panics
    /// Where the record refers to older moments than it may.
    pub fn push(&mut self, record: Record) {
        assert!(record.now + self.lag >= self.moments.next(), "a record of a forgotten moment");
        match self.records.get_mut(self.next) {
            Some(place) => *place = record,
            None => self.records.push(record),
        }
        self.next = (self.next + 1) % self.capacity;
        if let Some(oldest) = self.records.get(self.next).filter(|_| self.is_full()) {
            self.moments.forget_before(oldest.now.saturating_sub(self.lag));
        }
    }

    /// Whether the next record replaces one.
    fn is_full(&self) -> bool {
        self.records.len() == self.capacity
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is no record.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// A record and its moments.
    #[inline]
    pub fn get(&self, index: usize) -> Sample<'_> {
        let record = &self.records[index];
        let (now, next) = (record.now, record.now + u64::from(record.ahead));
        Sample { record, now: self.moments.get(now), next: self.moments.get(next) }
    }

    /// Reads a little of each of these records, so that all are on their way from memory at the same time.
    pub fn fetch(&self, indices: impl Iterator<Item = usize> + Clone) {
        let records = indices.map(|index| &self.records[index]);
        let read = records.clone().fold(0, |sum, record| sum ^ record.task);
        std::hint::black_box(read);
        let read = records.fold(0, |sum, record| {
            let next = record.now + u64::from(record.ahead);
            sum ^ self.moments.fetch(record.now) ^ self.moments.fetch(next)
        });
        // What was read is not needed, which the compiler must not know.
        std::hint::black_box(read);
    }

    /// Whether this is a replay of that size whose parts fit together, as one from a file should be.
    pub fn fits(&self, capacity: usize, lag: u64, spec: &Spec) -> bool {
        let Self { records, moments, .. } = self;
        let next = |record: &Record| record.now.checked_add(record.ahead.into());
        (self.capacity, self.lag) == (capacity, lag)
            && records.len() <= self.capacity
            && self.next < self.capacity.max(1)
            && moments.fits(spec)
            && records.iter().all(|record| moments.has(record.now))
            && records.iter().all(|record| next(record).is_some_and(|next| moments.has(next)))
    }
}

impl Samples for Replay {
    fn count(&self) -> usize {
        self.len()
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::Shape;
    use sortie_envs::random::{below, generator};

    use super::*;

    fn moment_spec() -> Spec {
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        Spec { shape, state_bytes: 6, ..Spec::default() }
    }

    fn state(number: u64) -> Vec<u8> {
        vec![number as u8; 3 + (number % 4) as usize]
    }

    #[test]
    fn moments_are_what_was_said_of_them_and_old_ones_are_forgotten() {
        let mut moments = Moments::new(&moment_spec());
        assert!(moments.fits(&moment_spec()) && !moments.has(0));
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
        assert!(moments.fits(&moment_spec()));
        moments.forget_before(u64::MAX);
        assert!(moments.has(4999) && moments.fits(&moment_spec()), "the running block stays");
    }

    #[test]
    fn moments_of_a_file_fit_only_where_all_of_them_do() {
        let mut moments = Moments::new(&moment_spec());
        for number in 0..1500 {
            moments.push(&state(number), &[0; 2]);
        }
        assert!(!moments.fits(&Spec { state_bytes: 7, ..moment_spec() }));
        let broken: [fn(&mut Moments); 4] = [
            |moments| moments.next += 1,
            |moments| moments.first = 2,
            |moments| moments.blocks[0].truncate(5),
            |moments| moments.blocks.swap(0, 1),
        ];
        for change in broken {
            let mut changed = moments.clone();
            change(&mut changed);
            assert!(!changed.fits(&moment_spec()));
        }
    }

    const LAG: u64 = 40;

    fn spec() -> Spec {
        let shape = Shape { agents: 3, entities: 130, tasks: 2, actions: 4, features: 5 };
        Spec { shape, state_bytes: 8, ..Spec::default() }
    }

    fn push_moment(replay: &mut Replay) -> u64 {
        let number = replay.moments.next();
        replay.moments.push(&number.to_le_bytes(), &[0; 3])
    }

    fn number(moment: Moment<'_>) -> u64 {
        moment.state.try_into().map_or(u64::MAX, u64::from_le_bytes)
    }

    #[test]
    fn every_record_keeps_its_moments_until_it_is_replaced() {
        let (mut replay, mut random) = (Replay::new(700, LAG, &spec()), generator(1));
        let mut pushed = Vec::new();
        for _ in 0..20_000 {
            let newest = push_moment(&mut replay);
            // Some moments are of no record, some of several, and not in their order.
            for _ in 0..below(&mut random, 3) {
                let now = newest.saturating_sub(below(&mut random, LAG as usize) as u64);
                let next = now + below(&mut random, (newest - now) as usize + 1) as u64;
                replay.push(Record::new(0, [now, next], 0));
                pushed.push([now, next]);
            }
            assert!(replay.fits(700, LAG, &spec()), "no moment of a record is forgotten");
        }
        assert!(replay.len() == 700 && pushed.len() > 15_000);
        let mut kept: Vec<_> = (0..700)
            .map(|index| {
                let Sample { now, next, .. } = replay.get(index);
                [number(now), number(next)]
            })
            .collect();
        replay.fetch(0..700);
        kept.rotate_left(pushed.len() % 700);
        assert_eq!(kept, pushed[pushed.len() - 700..]);
        assert!(!replay.moments.has(15_000), "what is of no record any more is forgotten");
    }

    #[test]
    fn a_record_has_a_team_and_things_in_sight() {
        let mut replay = Replay::new(2, LAG, &spec());
        let now = push_moment(&mut replay);
        replay.moments.allocate(now, &[1, 0]);
        let things = 1 << 127 | 1 << 3;
        replay.push(Record::new(1, [now; 2], things));
        let sample = replay.get(0);
        assert_eq!((sample.team(), sample.record.things()), (0b001, things));
    }

    #[test]
    fn a_replay_of_a_file_fits_only_where_all_its_records_do() {
        let mut replay = Replay::new(3, LAG, &spec());
        for _ in 0..5 {
            let now = push_moment(&mut replay);
            replay.push(Record::new(0, [now; 2], 0));
        }
        assert!(replay.fits(3, LAG, &spec()));
        assert!(!replay.fits(4, LAG, &spec()) && !replay.fits(3, LAG + 1, &spec()));
        let broken: [fn(&mut Replay); 4] = [
            |replay| replay.next = 3,
            |replay| replay.records[1].now = 5,
            |replay| replay.records[1].ahead = 9,
            |replay| replay.records.extend_from_within(..),
        ];
        for change in broken {
            let mut changed = replay.clone();
            change(&mut changed);
            assert!(!changed.fits(3, LAG, &spec()));
        }
    }
}
