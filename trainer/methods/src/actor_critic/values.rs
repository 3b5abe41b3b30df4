//! What critics are shown and what they say, whatever their layers.

use sortie_nn::tape::{Linear, Pass, Var};

use super::groups::Rows;

/// Slope of leaky ReLU below zero.
pub(crate) const SLOPE: f32 = 0.01;

/// What was done, as a critic is shown it, by groups.
#[derive(Debug, Default)]
pub struct Encoded {
    /// `[rows, columns]`
    pub(crate) taken: Rows,
    /// `[rows, actions]`: the own action, which only some critics see.
    pub(crate) own: Rows,
}

/// What a critic is shown, by groups: rows of records.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// `[rows, inputs]`
    pub observations: &'a Rows,
    /// What was done.
    pub encoded: &'a Encoded,
}

/// What a critic says.
#[derive(Debug)]
pub struct Values {
    /// By groups, `[rows, actions]`: the value of each own action, or `[rows, 1]` of the one that it sees.
    pub of_actions: Vec<Var>,
    /// `[rows, width]`: what attention makes of the others, where it is learned.
    pub attended: Option<Var>,
    /// `[rows, 1]`: the squared scores of attention, where it is learned.
    pub squared_scores: Option<Var>,
    /// By groups, `[rows, actions]`: the leaves of own actions that it sees.
    pub own: Vec<Var>,
}

/// A layer with leaky ReLU behind it.
pub(crate) fn leaky(pass: &mut Pass<'_>, x: Var, layer: Linear) -> Var {
    bent(pass, x, layer, SLOPE)
}

/// A layer behind which numbers below zero count so many times as much.
pub(crate) fn bent(pass: &mut Pass<'_>, x: Var, layer: Linear, slope: f32) -> Var {
    if slope == 0.0 {
        return pass.linear_rectified(x, layer);
    }
    let y = pass.linear(x, layer);
    pass.leaky_relu(y, slope)
}
