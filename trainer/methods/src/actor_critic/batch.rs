//! What an update sees.

use super::groups::{Groups, Rows, emptied};

/// Records, by groups: rows of agents.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Joint records.
    pub records: usize,
    /// `[rows, inputs]`: what they saw.
    pub observations: Rows,
    /// `[rows]`: what they did.
    pub actions: Vec<Vec<u32>>,
    /// `[rows]`: what they earned until the next observation.
    pub rewards: Rows,
    /// `[rows]`: what the value of the next observation counts, 0 behind an end.
    pub discounts: Rows,
    /// `[rows, inputs]`: what they saw next.
    pub next: Rows,
    /// `[records]`: whether the next record is the next decision of the same episode; empty where none is.
    pub follows: Vec<bool>,
    /// `[records, columns]`: whole states, and those that followed, where the critic sees them.
    pub states: [Vec<f32>; 2],
    /// By groups and heads, `[rows]`: what heads are paid besides; empty of heads that are paid nothing.
    pub paid: Rows,
}

impl Batch {
    /// Forgets all records; there are so many groups, and this many groups and heads.
    pub(crate) fn clear(&mut self, [groups, each]: [usize; 2]) {
        self.records = 0;
        self.follows.clear();
        emptied(&mut self.actions, groups);
        let Self { observations, rewards, discounts, next, .. } = self;
        for rows in [observations, rewards, discounts, next] {
            emptied(rows, groups);
        }
        self.states.iter_mut().for_each(Vec::clear);
        emptied(&mut self.paid, each);
    }

    /// Adds what agents did in a record, earned by it, and what the value of what followed counts.
    pub(crate) fn add(
        &mut self,
        groups: &Groups,
        actions: &[u16],
        reward: impl Fn(usize) -> f32,
        discount: f32,
    ) {
        self.records += 1;
        for (index, group) in groups.0.iter().enumerate() {
            let own = || group.agents.clone();
            self.actions[index].extend(actions[own()].iter().map(|action| u32::from(*action)));
            self.rewards[index].extend(own().map(&reward));
            self.discounts[index].extend(own().map(|_| discount));
        }
    }
}
