//! What was decided and what it earned, up to the next decision.

use serde::{Deserialize, Serialize};

use crate::alma::records::learner::Samples;

/// A state with the allocation that was made in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// The state.
    pub state: Vec<u8>,
    /// The subtask of every agent `[A]`.
    pub allocation: Vec<u8>,
}

impl Decision {
    /// What was decided for the agents that exist in a state.
    pub fn new(state: &[u8], allocation: &[u8]) -> Self {
        Self { state: state.to_vec(), allocation: allocation.to_vec() }
    }

    /// The agents at a subtask, as bits.
    pub fn team(&self, task: usize) -> u64 {
        let members = self.allocation.iter().enumerate();
        members.filter(|(_, own)| usize::from(**own) == task).map(|(agent, _)| 1 << agent).sum()
    }
}

/// The steps from one decision to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// What was decided.
    pub now: Decision,
    /// Discounted sum `[T]` of each task's rewards in between.
    pub rewards: Vec<f32>,
    /// Discount of what follows, a power of the discount of a step; 0 where the episode ended.
    pub discount: f32,
    /// What was decided then; `now` once more where the episode ended.
    pub next: Decision,
}

impl Segment {
    /// Whether its parts are of the same episode, as they should be.
    fn fits(&self) -> bool {
        let sizes = |decision: &Decision| (decision.state.len(), decision.allocation.len());
        sizes(&self.now) == sizes(&self.next)
    }
}

/// A ring of segments: the newest replaces the oldest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segments {
    capacity: usize,
    segments: Vec<Segment>,
    next: usize,
}

impl Segments {
    /// Room for `capacity` segments, at least one.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), segments: Vec::new(), next: 0 }
    }

    /// Stores a segment.
    pub fn push(&mut self, segment: Segment) {
        match self.segments.get_mut(self.next) {
            Some(place) => *place = segment,
            None => self.segments.push(segment),
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Number of segments.
    pub fn len(&self) -> usize {
        self.segments.len()
    }

    /// Whether there is no segment.
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// A segment.
    pub fn get(&self, index: usize) -> &Segment {
        &self.segments[index]
    }

    /// Reads a little of the states of each of these segments, so that all are on their way from memory at the same time.
    pub(super) fn fetch(&self, indices: impl Iterator<Item = usize>) {
        let first = |decision: &Decision| decision.state.first().copied().unwrap_or(0);
        let read = indices
            .map(|index| first(&self.segments[index].now) ^ first(&self.segments[index].next));
        // What was read is not needed, which the compiler must not know.
        std::hint::black_box(read.fold(0, |sum, read| sum ^ read));
    }

    /// Whether this is a ring of that size whose parts fit together, as one from a file should be.
    pub fn fits(&self, capacity: usize) -> bool {
        self.capacity == capacity
            && self.segments.len() <= capacity
            && self.next < capacity
            && self.segments.iter().all(Segment::fits)
    }
}

impl Samples for Segments {
    fn count(&self) -> usize {
        self.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_segment_replaces_the_oldest() {
        let segment = |reward| Segment {
            now: Decision::default(),
            rewards: vec![reward],
            discount: 0.9,
            next: Decision::default(),
        };
        let mut segments = Segments::new(2);
        for reward in [1.0, 2.0, 3.0] {
            segments.push(segment(reward));
        }
        assert_eq!(segments.len(), 2);
        assert_eq!([segments.get(0), segments.get(1)].map(|s| s.rewards[0]), [3.0, 2.0]);
    }

    #[test]
    fn a_ring_from_a_file_fits_only_where_all_its_parts_do() {
        let decision = |bytes: usize, allocated: usize| Decision {
            state: vec![0; bytes],
            allocation: vec![0; allocated],
        };
        let segment = |now, next| Segment { now, rewards: vec![0.0; 2], discount: 0.9, next };
        let ring = |segment: Segment| Segments { capacity: 2, segments: vec![segment], next: 1 };
        let sound = ring(segment(decision(9, 2), decision(9, 2)));
        assert!(sound.fits(2) && !sound.fits(3) && !sound.is_empty());
        assert_eq!((sound.count(), Segments::new(2).is_empty()), (1, true));
        for broken in
            [segment(decision(9, 2), decision(8, 2)), segment(decision(9, 2), decision(9, 1))]
        {
            assert!(!ring(broken).fits(2));
        }
        let other = segment(decision(1, 1), decision(1, 1));
        let full = Segments { capacity: 2, segments: vec![other.clone(); 2], next: 0 };
        assert_eq!(full.count(), 2);
        assert!(full.fits(2) && !Segments { next: 2, ..full.clone() }.fits(2));
        assert!(!Segments { segments: vec![other; 3], ..full }.fits(2));
    }

    #[test]
    fn a_team_is_the_bits_of_its_agents() {
        let decision = Decision { allocation: vec![2, 0, 2, 255], ..Decision::default() };
        assert_eq!([0, 1, 2].map(|task| decision.team(task)), [0b10, 0, 0b101]);
    }
}
