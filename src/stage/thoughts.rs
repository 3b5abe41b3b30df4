//! What agents think, in numbers and letters that people read.

use alloc::string::String;
use alloc::vec::Vec;

use serde::Serialize;

/// What one agent computes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Thought {
    /// Utility of every action, available or not.
    pub utilities: Vec<f64>,
    /// Whom it attends to.
    pub attention: Vec<Attention>,
    /// What each of its heads thinks, where it explores by several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub heads: Vec<Head>,
    /// What it goes for, where it runs options.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub option: Option<Pursued>,
}

/// How much an agent attends to one entity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Attention {
    /// Agents first.
    pub entity: usize,
    /// One weight per head.
    pub weights: Vec<f64>,
}

/// What one of the heads thinks by which an agent explores.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Head {
    /// What it explores for.
    pub name: String,
    /// Its intrinsic reward for being here.
    pub pays: f64,
    /// The action that it likes best.
    pub likes: u16,
    /// Whether the agent acts by it.
    pub acts: bool,
}

/// What an agent that runs options goes for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pursued {
    /// The milestone.
    pub goal: usize,
    /// Its step of the option, from 1.
    pub step: usize,
    /// How likely it believes each milestone can be reached next.
    pub likelihoods: Vec<f64>,
    /// Those that it can choose from, as bits.
    pub mask: u32,
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
            heads: Vec::new(),
            option: None,
        }
    }
}

/// Four decimals are enough to read, and keep pages small.
pub fn rounded(value: impl Into<f64>) -> f64 {
    let rounded = libm::round(value.into() * 1e4) / 1e4;
    // Minus zero reads oddly.
    rounded + 0.0
}
