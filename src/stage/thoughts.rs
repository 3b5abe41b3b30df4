//! What agents think, in numbers that people read.

use alloc::vec::Vec;

use serde::Serialize;

/// What one agent computes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Thought {
    /// Utility of every action, available or not.
    pub utilities: Vec<f64>,
    /// Whom it attends to.
    pub attention: Vec<Attention>,
}

/// How much an agent attends to one entity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Attention {
    /// Agents first.
    pub entity: usize,
    /// One weight per head.
    pub weights: Vec<f64>,
}

impl Thought {
    /// Utilities, and the weights of every head for each visible entity.
    pub fn new(utilities: &[f32], attention: Vec<(usize, Vec<f32>)>) -> Self {
        let attended = |(entity, weights): (usize, Vec<f32>)| Attention {
            entity,
            weights: weights.into_iter().map(rounded).collect(),
        };
        Self {
            utilities: utilities.iter().copied().map(rounded).collect(),
            attention: attention.into_iter().map(attended).collect(),
        }
    }
}

/// Four decimals are enough to read, and keep pages small.
pub fn rounded(value: impl Into<f64>) -> f64 {
    let rounded = libm::round(value.into() * 1e4) / 1e4;
    // Minus zero reads oddly.
    rounded + 0.0
}
