//! What makes better weights of a gradient.

use sortie_learn::state::State;
use sortie_learn::{LearnError, state};
use sortie_nn::optimise::{Adam, RmsProp};

use super::config::Rule;

/// An optimiser of one parameter vector.
#[derive(Clone, Debug)]
pub(super) enum Optimiser {
    Adam(Adam),
    RmsProp(RmsProp),
}

impl Optimiser {
    /// One that has taken no step yet.
    pub(super) fn new(rule: Rule, parameters: usize, epsilon: f32) -> Self {
        match rule {
            Rule::Adam => Self::Adam(Adam::new(parameters, epsilon)),
            Rule::RmsProp => Self::RmsProp(RmsProp::new(parameters)),
        }
    }

    /// Takes one step down the gradient.
    pub(super) fn step(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f32) {
        match self {
            Self::Adam(adam) => adam.step(&mut [parameters], gradient, learning_rate),
            Self::RmsProp(rule) => rule.step(parameters, gradient, learning_rate),
        }
    }

    /// Names what later steps depend on.
    pub(super) fn state(
        &mut self,
        state: &mut State<'_>,
        tensors: &[state::Tensor],
    ) -> Result<(), LearnError> {
        match self {
            Self::Adam(adam) => {
                state.tensors("adam-mean", tensors, &mut adam.mean)?;
                state.tensors("adam-square", tensors, &mut adam.square)?;
                state.value("adam-steps", &mut adam.steps)
            }
            Self::RmsProp(rule) => state.tensors("square", tensors, &mut rule.square),
        }
    }
}
