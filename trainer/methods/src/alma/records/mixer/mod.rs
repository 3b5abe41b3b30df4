//! Mixing networks: the value of a team from the utilities of its agents' chosen actions.
//!
//! Used in training only. A mixer sees the same rows as the agents that it mixes, so that the subtask
//! mask holds for it as well (dissertation section 7.3).

mod hypernetwork;
mod linear;
mod qmix;
mod sum;

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::alma::agents::{UtilityInput, sized};
use hypernetwork::{HypernetworkPass, HypernetworkShape};
use sortie_nn::random::{Generator, signed_unit};

/// How the utilities of a team become its value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MixerKind {
    /// Their sum (VDN).
    #[default]
    Sum,
    /// A sum with weights that add up to 1, and a value of the state.
    Linear,
    /// Two layers with non-negative weights (QMIX).
    Qmix,
}

/// Sizes of a mixer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// How it mixes.
    pub kind: MixerKind,
    /// Input columns D of one entity, as of the utility network.
    pub input: usize,
    /// Width of the hypernetwork's embedding and attention.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
    /// Width M between the two layers of QMIX.
    pub mixing: usize,
}

impl MixerShape {
    fn hypernetwork(self) -> HypernetworkShape {
        let Self { kind, input, width, heads, mixing } = self;
        let outputs = if kind == MixerKind::Qmix { qmix::outputs(mixing) } else { linear::OUTPUTS };
        HypernetworkShape { input, width, heads, outputs }
    }

    /// Where each tensor stands in the flat parameter vector; a sum has none.
    pub fn tensors(self) -> Vec<MixerTensor> {
        match self.kind {
            MixerKind::Sum => Vec::new(),
            MixerKind::Linear | MixerKind::Qmix => self.hypernetwork().tensors().into(),
        }
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.tensors().last().map_or(0, |tensor| tensor.range.end)
    }
}

/// One tensor in the flat parameter vector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MixerTensor {
    /// Its name.
    pub name: &'static str,
    /// Inputs of its layer.
    pub inputs: usize,
    /// Its place.
    pub range: Range<usize>,
}

/// A mixer: its sizes and all parameters in one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixer {
    shape: MixerShape,
    parameters: Vec<f32>,
}

impl Mixer {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does, where `fc1`
    /// counts as having `active_inputs`, as the utility network's.
    pub fn initialise(shape: MixerShape, active_inputs: f32, generator: &mut Generator) -> Self {
        let mut parameters = vec![0.0; shape.parameters()];
        for (place, tensor) in shape.tensors().into_iter().enumerate() {
            let inputs = if place < 2 { active_inputs } else { tensor.inputs as f32 };
            for value in &mut parameters[tensor.range] {
                *value = signed_unit(generator) / inputs.sqrt();
            }
        }
        Self { shape, parameters }
    }

    /// A mixer with these parameters, or `None` where their number does not fit the shape.
    pub fn from_parameters(shape: MixerShape, parameters: Vec<f32>) -> Option<Self> {
        (parameters.len() == shape.parameters()).then_some(Self { shape, parameters })
    }

    /// The sizes.
    pub fn shape(&self) -> MixerShape {
        self.shape
    }

    /// All parameters, in the order of [`MixerShape::tensors`].
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }
}

/// Teams to mix: those of an input, one behind the other.
#[derive(Clone, Copy, Debug)]
pub struct Teams<'a> {
    /// What the agents see; its acting agents are those of the teams.
    pub input: &'a UtilityInput,
    /// Number of agents of each team, at least one.
    pub sizes: &'a [usize],
    /// Utility `[agents]` of every agent's chosen action.
    pub utilities: &'a [f32],
}

impl<'a> Teams<'a> {
    /// The agents of every team and their utilities.
    fn each(self) -> impl Iterator<Item = (Range<usize>, &'a [f32])> {
        let mut end = 0;
        self.sizes.iter().map(move |size| {
            let team = end..end + size;
            end = team.end;
            (team.clone(), &self.utilities[team])
        })
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct MixerPass {
    hypernetwork: HypernetworkPass,
    linear: linear::Linear,
    qmix: qmix::Qmix,
    values: Vec<f32>,
    d_numbers: Vec<f32>,
}

impl MixerPass {
    /// Computes the value of every team.
    pub fn forward(&mut self, mixer: &Mixer, teams: Teams<'_>) -> &[f32] {
        let MixerShape { kind, mixing, .. } = mixer.shape;
        let values = sized(&mut self.values, teams.sizes.len());
        let (shape, parameters) = (mixer.shape.hypernetwork(), &mixer.parameters);
        match kind {
            MixerKind::Sum => sum::forward(teams, values),
            MixerKind::Linear => {
                let numbers = self.hypernetwork.forward(shape, parameters, teams.input);
                self.linear.forward(teams, numbers, values);
            }
            MixerKind::Qmix => {
                let numbers = self.hypernetwork.forward(shape, parameters, teams.input);
                self.qmix.forward(mixing, teams, numbers, values);
            }
        }
        values
    }

    /// Writes the slope by every utility, and adds to `gradient` (all parameters), for a loss whose slope
    /// by the values of the last forward pass is `d_values`.
    pub fn backward(
        &mut self,
        mixer: &Mixer,
        teams: Teams<'_>,
        d_values: &[f32],
        d_utilities: &mut [f32],
        gradient: &mut [f32],
    ) {
        let shape = mixer.shape.hypernetwork();
        let d_numbers = sized(&mut self.d_numbers, teams.utilities.len() * shape.outputs);
        match mixer.shape.kind {
            MixerKind::Sum => return sum::backward(teams, d_values, d_utilities),
            MixerKind::Linear => self.linear.backward(teams, d_values, d_utilities, d_numbers),
            MixerKind::Qmix => {
                let mixing = mixer.shape.mixing;
                self.qmix.backward(mixing, teams, d_values, d_utilities, d_numbers);
            }
        }
        self.hypernetwork.backward(shape, &mixer.parameters, teams.input, d_numbers, gradient);
    }
}

#[cfg(test)]
mod tests;
