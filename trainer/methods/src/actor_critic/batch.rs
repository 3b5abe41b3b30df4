//! What an update sees, and what networks are shown of it.

use super::acting::{Inputs, show};
use super::groups::Groups;
use super::replay::{Future, Place, Replay};

/// Records, by groups: rows of agents.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Joint records.
    pub records: usize,
    /// `[rows, inputs]`: what they saw.
    pub observations: Vec<Vec<f32>>,
    /// `[rows]`: what they did.
    pub actions: Vec<Vec<u32>>,
    /// `[rows]`: what they earned until the next observation.
    pub rewards: Vec<Vec<f32>>,
    /// `[rows]`: what the value of the next observation counts, 0 behind an end.
    pub discounts: Vec<Vec<f32>>,
    /// `[rows, inputs]`: what they saw next.
    pub next: Vec<Vec<f32>>,
    /// `[records]`: whether the next record is the next decision of the same episode; empty where none is.
    pub follows: Vec<bool>,
}

impl Batch {
    /// Forgets all records, keeps the memory.
    pub fn clear(&mut self, groups: &Groups) {
        fn emptied<T>(all: &mut Vec<Vec<T>>, groups: usize) {
            all.resize_with(groups, Vec::new);
            all.iter_mut().for_each(Vec::clear);
        }
        self.records = 0;
        self.follows.clear();
        emptied(&mut self.actions, groups.0.len());
        let Self { observations, rewards, discounts, next, .. } = self;
        for all in [observations, rewards, discounts, next] {
            emptied(all, groups.0.len());
        }
    }

    /// Adds a decision and what followed it within so many.
    pub(crate) fn add(
        &mut self,
        groups: &Groups,
        inputs: Inputs,
        replay: &Replay,
        place: Place,
        future: &Future,
    ) {
        self.records += 1;
        show(groups, inputs, replay.observation(place), &mut self.observations);
        if let Some(next) = future.next {
            show(groups, inputs, replay.observation(next), &mut self.next);
        }
        let actions = replay.actions(place);
        for (index, group) in groups.0.iter().enumerate() {
            let own = group.agents.clone();
            self.actions[index].extend(actions[own.clone()].iter().map(|a| u32::from(*a)));
            self.rewards[index].extend_from_slice(&future.rewards[own.clone()]);
            self.discounts[index].extend(own.map(|_| future.discount));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::groups::Group;
    use super::super::replay::Outcome;
    use super::*;

    #[test]
    fn a_decision_is_shown_with_what_followed_by_groups() {
        let group = |agents, observed, identity| Group { agents, observed, identity, actions: 9 };
        let groups = Groups(vec![group(0..2, 1, true), group(2..3, 2, false)]);
        let mut replay = Replay::new(1, 8, 3, 4);
        // What agents earn is kept in deviations, so that it takes two decisions to tell rewards apart.
        let mut places = Vec::new();
        for (number, is_last) in [(0.0, false), (4.0, true)] {
            replay.decide(0, &[number, number + 1.0, number + 2.0, number + 3.0], &[3, 5, 8]);
            let rewards = &[number, -number, 2.0 * number];
            places.push(replay.conclude(0, Outcome { rewards, discount: 0.5, is_last }));
        }
        replay.end(0, &[8.0, 9.0, 10.0, 11.0]);
        let (mut batch, mut future) = (Batch::default(), Future::default());
        batch.clear(&groups);
        for (place, steps) in [(places[0], 2), (places[1], 2)] {
            replay.future(place, steps, true, &mut future);
            let inputs = Inputs { normalised: false, scale: 2.0 };
            batch.add(&groups, inputs, &replay, place, &future);
        }
        assert_eq!(batch.records, 2);
        let first = [0.0, 1.0, 0.0, 2.0, 0.0, 1.0, 8.0, 1.0, 0.0, 10.0, 0.0, 1.0];
        assert_eq!(batch.observations, [first.to_vec(), vec![4.0, 6.0, 12.0, 14.0]]);
        let next = [16.0, 1.0, 0.0, 18.0, 0.0, 1.0];
        assert_eq!(batch.next, [next.repeat(2), [20.0, 22.0].repeat(2)]);
        assert_eq!(batch.actions, [vec![3, 5, 3, 5], vec![8, 8]]);
        // Rewards of -1 and 1 in deviations, the sign of the second agent's turned.
        assert_eq!(batch.rewards, [vec![-0.5, 0.5, 1.0, -1.0], vec![-0.5, 1.0]]);
        assert_eq!(batch.discounts, [vec![0.25, 0.25, 0.5, 0.5], vec![0.25, 0.5]]);
    }
}
