//! Tensors in one flat vector of parameters.

use std::ops::Range;

use sortie_nn::random::{Generator, signed_unit};

/// One tensor and its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tensor {
    /// Its name in files.
    pub name: String,
    /// Inputs of its layer, by which its first weights are scaled.
    pub inputs: usize,
    /// Its place in the vector.
    pub range: Range<usize>,
}

impl Tensor {
    /// The same as checkpoints name it.
    pub(super) fn saved(&self) -> sortie_learn::state::Tensor {
        let Self { name, range, .. } = self;
        sortie_learn::state::Tensor {
            name: name.clone(),
            shape: vec![range.len()],
            range: range.clone(),
        }
    }
}

/// Places tensors `(name, inputs, numbers)` one behind the other.
pub(super) fn place(start: usize, prefix: &str, tensors: &[(&str, usize, usize)]) -> Vec<Tensor> {
    let mut end = start;
    let next = |&(name, inputs, numbers): &(&str, usize, usize)| {
        let range = end..end + numbers;
        end = range.end;
        Tensor { name: format!("{prefix}.{name}"), inputs, range }
    };
    tensors.iter().map(next).collect()
}

/// Cuts a vector into the tensors' parts.
pub(super) fn views<const COUNT: usize>(
    vector: &[f32],
    numbers: [usize; COUNT],
) -> [&[f32]; COUNT] {
    let mut rest = vector;
    numbers.map(|count| rest.split_off(..count).expect("one place per parameter"))
}

/// As [`views`], to be changed.
pub(super) fn views_mut<const COUNT: usize>(
    vector: &mut [f32],
    numbers: [usize; COUNT],
) -> [&mut [f32]; COUNT] {
    let mut rest = vector;
    numbers.map(|count| rest.split_off_mut(..count).expect("one place per parameter"))
}

/// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
pub(super) fn initialise(tensors: &[Tensor], parameters: &mut [f32], generator: &mut Generator) {
    for tensor in tensors {
        let bound = 1.0 / (tensor.inputs as f32).sqrt();
        parameters[tensor.range.clone()]
            .iter_mut()
            .for_each(|value| *value = bound * signed_unit(generator));
    }
}
