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
