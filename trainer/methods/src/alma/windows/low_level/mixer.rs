//! The flexible mixer of QMIX with its four hypernetworks and its PopArt head.
//!
//! Dissertation sections 5.3.2 and 7.3: `Q = w2 . elu(sum over agents of W1[a] q_a + b1) + V` for every
//! team, then `w Q + b` in normalised units. `W1` and `w2` are made non-negative; the public code of
//! ALMA makes `b1` and `V` so as well, which is a switch here.

use sortie_nn::random::{Generator, signed_unit};

use super::hypernetwork::{HypernetworkGradient, HypernetworkPass, Merged, MixerInput};
use super::mixer_shape::{HYPERNETWORKS, MixerShape};
use super::mixing::{Mixing, MixingGradient, Numbers};

/// A mixer: its sizes and all parameters in one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixer {
    shape: MixerShape,
    parameters: Vec<f32>,
}

impl Mixer {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does; the head
    /// changes nothing at first.
    pub fn initialise(shape: MixerShape, generator: &mut Generator) -> Self {
        let mut parameters = Vec::with_capacity(shape.parameters());
        for _ in HYPERNETWORKS {
            for (_, inputs, length) in shape.hypernetwork.tensors() {
                let bound = 1.0 / (inputs as f32).sqrt();
                parameters.extend((0..length).map(|_| bound * signed_unit(generator)));
            }
        }
        parameters.resize(parameters.len() + shape.outputs, 1.0);
        parameters.resize(parameters.len() + shape.outputs, 0.0);
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

    /// All parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// Weights and biases `[outputs]` of the PopArt head.
    pub fn head(&self) -> (&[f32], &[f32]) {
        let outputs = self.shape.outputs;
        self.parameters[self.parameters.len() - 2 * outputs..].split_at(outputs)
    }

    /// The same, to be changed.
    pub fn head_mut(&mut self) -> (&mut [f32], &mut [f32]) {
        let (outputs, length) = (self.shape.outputs, self.parameters.len());
        self.parameters[length - 2 * outputs..].split_at_mut(outputs)
    }

    /// What passes need beside the parameters, as long as these do not change.
    pub fn merge(&self) -> MergedMixer {
        let shape = self.shape.hypernetwork;
        let merged = self.shape.hypernetworks(&self.parameters).zip(HYPERNETWORKS);
        MergedMixer(merged.map(|(own, (_, mode))| Merged::new(shape, mode, own)).collect())
    }
}

/// The merged matrices of a mixer's hypernetworks.
#[derive(Clone, Debug)]
pub struct MergedMixer(Vec<Merged>);

/// The gradient of a mixer as passes add to it.
#[derive(Clone, Debug)]
pub struct MixerGradient {
    hypernetworks: Vec<HypernetworkGradient>,
    /// Of the head's weights and biases.
    pub(super) head: Vec<f32>,
}

impl MixerGradient {
    /// Zeros.
    pub fn new(shape: MixerShape) -> Self {
        let of = |(_, mode)| HypernetworkGradient::new(shape.hypernetwork, mode);
        Self { hypernetworks: HYPERNETWORKS.map(of).into(), head: vec![0.0; 2 * shape.outputs] }
    }

    /// Sets all to zero.
    pub fn clear(&mut self) {
        self.hypernetworks.iter_mut().for_each(HypernetworkGradient::clear);
        self.head.fill(0.0);
    }

    /// Adds another gradient of the same mixer.
    pub fn add(&mut self, other: &Self) {
        for (sum, other) in self.hypernetworks.iter_mut().zip(&other.hypernetworks) {
            sum.add(other);
        }
        self.head.iter_mut().zip(&other.head).for_each(|(sum, value)| *sum += value);
    }

    /// Writes the gradient of all parameters.
    pub fn write(&self, mixer: &Mixer, merged: &MergedMixer, gradient: &mut [f32]) {
        let own = mixer.shape.hypernetwork.parameters();
        let (hypernetworks, head) = gradient.split_at_mut(4 * own);
        let places = hypernetworks.chunks_exact_mut(own);
        let parameters = mixer.shape.hypernetworks(&mixer.parameters).zip(&merged.0);
        for ((part, gradient), (parameters, merged)) in
            self.hypernetworks.iter().zip(places).zip(parameters)
        {
            part.write(parameters, merged, gradient);
        }
        head.copy_from_slice(&self.head);
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct MixerPass {
    hypernetworks: [HypernetworkPass; 4],
    mixing: Mixing,
    gradient: MixingGradient,
}

impl MixerPass {
    /// Floating-point operations of all passes up to now, see [`HypernetworkPass::operations`].
    pub fn operations(&self) -> u64 {
        self.hypernetworks.iter().map(HypernetworkPass::operations).sum()
    }

    /// Computes the value of every team before the head, from the utilities of all agents' actions.
    pub fn forward(
        &mut self,
        mixer: &Mixer,
        merged: &MergedMixer,
        input: &MixerInput,
        utilities: &[f32],
    ) -> &[f32] {
        let MixerShape { hypernetwork, slots, .. } = mixer.shape;
        let mut networks = mixer.shape.hypernetworks(&mixer.parameters).zip(&merged.0);
        let mut modes = HYPERNETWORKS.into_iter();
        let numbers = self.hypernetworks.each_mut().map(|pass| {
            let ((parameters, merged), (_, mode)) =
                networks.next().zip(modes.next()).expect("four hypernetworks");
            pass.forward((hypernetwork, mode, slots), parameters, merged, input)
        });
        self.mixing.forward(mixer.shape, &input.teams, Numbers(numbers), utilities)
    }

    /// Adds to `gradient` that of a loss whose slope by the values of the last forward pass is
    /// `d_values`; returns the slope by the utilities.
    pub fn backward(
        &mut self,
        mixer: &Mixer,
        merged: &MergedMixer,
        input: &MixerInput,
        (utilities, d_values): (&[f32], &[f32]),
        gradient: &mut MixerGradient,
    ) -> &[f32] {
        let MixerShape { hypernetwork, slots, .. } = mixer.shape;
        self.mixing.backward(mixer.shape, &input.teams, utilities, d_values, &mut self.gradient);
        let networks = mixer.shape.hypernetworks(&mixer.parameters).zip(&merged.0);
        let passes = self.hypernetworks.iter_mut().zip(&mut self.gradient.numbers);
        for ((((_, mode), (parameters, merged)), (pass, d_numbers)), gradient) in
            HYPERNETWORKS.into_iter().zip(networks).zip(passes).zip(&mut gradient.hypernetworks)
        {
            let shape = (hypernetwork, mode, slots);
            pass.backward(shape, parameters, merged, input, d_numbers, gradient);
        }
        &self.gradient.utilities
    }
}
