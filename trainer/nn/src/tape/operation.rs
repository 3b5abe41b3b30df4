//! What a step of a tape computes, and from what.

use super::Var;
use super::parameters::{Gru, Linear, Norm};
use crate::layers::attention::AttentionShape;
use crate::layers::elementwise::Activation;
use crate::layers::unfold::UnfoldShape;

/// A part of the tape's indices.
pub(super) type Indices = (u32, u32);

#[derive(Clone, Copy, Debug)]
pub(super) enum Operation {
    /// Given from outside, or the memory of another step seen otherwise.
    Given,
    Linear {
        x: Var,
        layer: Linear,
        rectified: bool,
    },
    /// Two products and the offsets of the first layer, rectified.
    LinearSum {
        x: [Var; 2],
        layers: [Linear; 2],
    },
    /// `rows` is the place of the features in their pool.
    SparseLinear {
        rows: u32,
        layer: Linear,
    },
    Activate {
        x: Var,
        activation: Activation,
    },
    Softmax {
        x: Var,
    },
    LogSoftmax {
        x: Var,
    },
    Normalise {
        x: Var,
    },
    /// Columns times and plus parameters.
    Affine {
        x: Var,
        layer: Norm,
    },
    /// `weights` is where the attention weights begin in the arena.
    Attend {
        queries: Var,
        keys_values: Var,
        lists: u32,
        weights: u32,
        shape: AttentionShape,
    },
    SquaredScores {
        queries: Var,
        keys_values: Var,
        lists: u32,
        shape: AttentionShape,
    },
    /// `carry` is where it begins in the tape's.
    Recur {
        x: Var,
        pass: u32,
        carry: u32,
        slots: u32,
        layer: Gru,
    },
    Unfold {
        x: Var,
        shape: UnfoldShape,
    },
    /// Row i is row `indices[i]` of `x`.
    Gather {
        x: Var,
        indices: Indices,
    },
    /// Row `indices[i]` gets row i of `x` added.
    Scatter {
        x: Var,
        indices: Indices,
    },
    /// Row i is the one number in column `indices[i]`.
    Pick {
        x: Var,
        indices: Indices,
    },
    Columns {
        x: Var,
        first: u32,
    },
    /// Columns of several; the indices are their numbers.
    Concat {
        parts: Indices,
    },
    /// One number for each row.
    SumColumns {
        x: Var,
    },
    Scale {
        x: Var,
        factor: f32,
    },
    Add {
        a: Var,
        b: Var,
    },
    Multiply {
        a: Var,
        b: Var,
    },
    /// Every row times its number.
    ScaleRows {
        x: Var,
        by: Var,
    },
    /// `value + advantage - mean of the row's advantages`.
    Dueling {
        value: Var,
        advantages: Var,
    },
    SquaredError {
        x: Var,
        target: Var,
        factor: f32,
    },
    Huber {
        x: Var,
        target: Var,
        factor: f32,
        bound: f32,
    },
    Custom {
        x: Var,
        number: u32,
    },
}
