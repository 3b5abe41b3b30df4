//! What was seen: moments, and records that refer to them. A record is a step of one team.
//!
//! Features are rebuilt when a record is used.

use serde::{Deserialize, Serialize};
use sortie_envs::{AgentSet, EntitySet, Spec};

use super::learner::Samples;
use super::moments::{Moment, Moments};

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
    /// What the records refer to.
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
    use super::*;
    use sortie_envs::Shape;
    use sortie_envs::random::{below, generator};

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
