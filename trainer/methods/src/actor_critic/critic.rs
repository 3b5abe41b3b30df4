//! What an update sees of records, and what critics are shown of them and say, whatever their layers.

use std::fmt;
use std::ops::Range;

use sortie_nn::tape::{Pass, Var};

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

/// What makes values of what all see and do.
pub trait Critic: fmt::Debug + Send + Sync {
    /// How many of its weights, the first, serve so many values each.
    fn shared(&self) -> [usize; 2];

    /// The values of some records.
    fn values(&self, pass: &mut Pass<'_>, shown: Shown<'_>, records: Range<usize>) -> Values;
}

/// What a critic is shown of all records of a batch.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// By groups, `[rows, inputs]`.
    pub observations: &'a Rows,
    /// `[records, columns]`: whole states, which only some critics see.
    pub states: &'a [f32],
    /// By groups and heads, `[rows]`: what the others did.
    pub actions: &'a [Vec<u32>],
    /// By groups, `[rows, actions]`: the own action, which only some critics see.
    pub own: &'a Rows,
    /// Whether the critic learns, so that its attention counts.
    pub learns: bool,
}

/// What a critic says.
#[derive(Debug, Default)]
pub struct Values {
    /// By groups and heads.
    pub of_actions: Vec<Value>,
    /// `[rows, width]`: what attention makes of the others, where it is no plain mean.
    pub attended: Option<Var>,
    /// `[rows, 1]`: the squared scores of attention, where it learns.
    pub squared_scores: Option<Var>,
    /// By groups, `[rows, actions]`: the leaves of own actions that it sees.
    pub own_actions: Vec<Var>,
}

/// Values of a group's actions for one head: `[rows, actions]`, or `[rows, 1]` of the own action that the critic sees.
#[derive(Clone, Copy, Debug)]
pub struct Value {
    /// In rewards of the agents.
    pub earned: Var,
    /// In what the head is paid, if it is.
    pub paid: Option<Var>,
}

impl From<Var> for Value {
    fn from(earned: Var) -> Self {
        Self { earned, paid: None }
    }
}
