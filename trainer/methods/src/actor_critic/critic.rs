//! What critics are shown of records and say of them, whatever their layers.

use std::fmt;
use std::ops::Range;

use sortie_nn::tape::{Pass, Var};

use super::groups::{Groups, Rows};

/// What makes values of what all see and do.
pub trait Critic: fmt::Debug + Send + Sync {
    /// How many of its weights, the first, serve so many values each.
    fn shared(&self) -> [usize; 2];

    /// The values of some records.
    fn values(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        shown: Shown<'_>,
        records: Range<usize>,
    ) -> Values;
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
    /// Whether that is normalised over the batch, as observations are.
    pub normalised: bool,
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
