//! Parameters of networks: named tensors in one vector.

use std::ops::Range;

use crate::layers::gru;
use crate::layers::linear::LinearShape;
use crate::random::{Generator, normals, signed_unit};

/// One tensor of a vector of parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tensor {
    /// Its name in files.
    pub name: String,
    /// Its sizes.
    pub shape: Vec<usize>,
    /// Its place.
    pub range: Range<usize>,
}

/// The parameters of a network. Optimisers and averages work on the vector, passes on layers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// All numbers, tensor behind tensor.
    pub values: Vec<f32>,
    tensors: Vec<Tensor>,
}

/// Where the parameters of a linear layer begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear {
    /// Its sizes.
    pub shape: LinearShape,
    /// `[output, input]`; of a sparse layer `[input, output]`.
    pub weight: usize,
    /// `[output]`, if it has any.
    pub bias: Option<usize>,
}

/// Where the parameters of a recurrent unit begin, which are those of [`gru::lengths`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gru {
    /// Width of input and memory.
    pub width: usize,
    /// The first of them.
    pub start: usize,
}

/// Hands out the places of layers, one behind the other in a vector of parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Places {
    /// Where the next layer begins.
    pub end: usize,
}

/// Where factors and offsets of columns begin, one behind the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Norm {
    /// Columns.
    pub width: usize,
    /// The first factor.
    pub start: usize,
}

impl Parameters {
    /// All tensors in their order.
    pub fn tensors(&self) -> &[Tensor] {
        &self.tensors
    }

    /// Adds a tensor of numbers uniform in `-bound..bound`.
    pub fn tensor(
        &mut self,
        name: &str,
        shape: &[usize],
        bound: f32,
        random: &mut Generator,
    ) -> usize {
        self.add(name, shape, || bound * signed_unit(random))
    }

    fn add(&mut self, name: &str, shape: &[usize], number: impl FnMut() -> f32) -> usize {
        let start = self.values.len();
        let range = start..start + shape.iter().product::<usize>();
        self.values.extend(std::iter::repeat_with(number).take(range.len()));
        self.tensors.push(Tensor { name: name.to_owned(), shape: shape.to_vec(), range });
        start
    }

    /// Adds a linear layer, drawn as PyTorch does: uniform in `±1/sqrt(inputs)`.
    pub fn linear(
        &mut self,
        name: &str,
        input: usize,
        output: usize,
        random: &mut Generator,
    ) -> Linear {
        let bound = 1.0 / (input as f32).sqrt();
        let weight = self.tensor(&format!("{name}.weight"), &[output, input], bound, random);
        let bias = Some(self.tensor(&format!("{name}.bias"), &[output], bound, random));
        Linear { shape: LinearShape { input, output }, weight, bias }
    }

    /// Adds a first layer for features that are mostly zeros: so many count as not.
    pub fn sparse_linear(
        &mut self,
        name: &str,
        [input, output]: [usize; 2],
        active: f32,
        random: &mut Generator,
    ) -> Linear {
        let bound = 1.0 / active.sqrt();
        let weight = self.tensor(&format!("{name}.weight"), &[input, output], bound, random);
        let bias = Some(self.tensor(&format!("{name}.bias"), &[output], bound, random));
        Linear { shape: LinearShape { input, output }, weight, bias }
    }

    /// Adds a linear layer without offsets.
    pub fn projection(
        &mut self,
        name: &str,
        input: usize,
        output: usize,
        random: &mut Generator,
    ) -> Linear {
        let bound = 1.0 / (input as f32).sqrt();
        let weight = self.tensor(&format!("{name}.weight"), &[output, input], bound, random);
        Linear { shape: LinearShape { input, output }, weight, bias: None }
    }

    /// Adds a linear layer of orthogonal weights (Saxe et al. 2014): the rows, or the columns where these are fewer, are
    /// of length 1 and at right angles. Offsets are 0.
    pub fn orthogonal(
        &mut self,
        name: &str,
        input: usize,
        output: usize,
        random: &mut Generator,
    ) -> Linear {
        let (vectors, length) = (input.min(output), input.max(output));
        let drawn = at_right_angles(normals(random, vectors * length), length);
        let mut place = 0..input * output;
        let weight = self.add(&format!("{name}.weight"), &[output, input], || {
            let place = place.next().unwrap_or(0);
            let (row, column) = (place / input, place % input);
            if output > input { drawn[column * length + row] } else { drawn[place] }
        });
        let bias = Some(self.add(&format!("{name}.bias"), &[output], || 0.0));
        Linear { shape: LinearShape { input, output }, weight, bias }
    }

    /// Adds a recurrent unit, drawn as PyTorch does, with PyTorch's names.
    pub fn gru(&mut self, name: &str, width: usize, random: &mut Generator) -> Gru {
        self.gru_of(name, ["weight_ih", "weight_hh", "bias_ih", "bias_hh"], width, random)
    }

    /// The same under other names of its tensors.
    pub fn gru_of(
        &mut self,
        name: &str,
        tensors: [&str; 4],
        width: usize,
        random: &mut Generator,
    ) -> Gru {
        let (start, bound) = (self.values.len(), 1.0 / (width as f32).sqrt());
        for (tensor, length) in tensors.into_iter().zip(gru::lengths(width)) {
            let shape = [3 * width, length / (3 * width)];
            let shape = if tensor.contains("bias") { &shape[..1] } else { &shape[..] };
            self.tensor(&format!("{name}.{tensor}"), shape, bound, random);
        }
        Gru { width, start }
    }

    /// Adds factors of 1 and offsets of 0, which change nothing.
    pub fn norm(&mut self, name: &str, width: usize) -> Norm {
        let start = self.add(&format!("{name}.weight"), &[width], || 1.0);
        self.add(&format!("{name}.bias"), &[width], || 0.0);
        Norm { width, start }
    }
}

impl Places {
    /// The place of so many numbers.
    pub fn numbers(&mut self, count: usize) -> usize {
        self.end += count;
        self.end - count
    }

    /// A linear layer, its offsets behind its weight.
    pub fn linear(&mut self, input: usize, output: usize) -> Linear {
        let Linear { shape, weight, .. } = self.projection(input, output);
        Linear { shape, weight, bias: Some(self.numbers(output)) }
    }

    /// A linear layer without offsets.
    pub fn projection(&mut self, input: usize, output: usize) -> Linear {
        let weight = self.numbers(input * output);
        Linear { shape: LinearShape { input, output }, weight, bias: None }
    }

    /// A recurrent unit.
    pub fn gru(&mut self, width: usize) -> Gru {
        Gru { width, start: self.numbers(gru::lengths(width).iter().sum()) }
    }
}

impl Linear {
    /// Where its weights stand.
    pub fn weight_range(self) -> Range<usize> {
        self.weight..self.weight + self.shape.input * self.shape.output
    }

    /// Where its offsets stand, if it has any.
    pub fn bias_range(self) -> Option<Range<usize>> {
        self.bias.map(|bias| bias..bias + self.shape.output)
    }
}

impl Gru {
    pub(super) fn range(self) -> Range<usize> {
        self.start..self.start + gru::lengths(self.width).iter().sum::<usize>()
    }
}

/// Vectors of such a length, each made as long as 1 and turned away from those before (Gram and Schmidt).
fn at_right_angles(mut vectors: Vec<f32>, length: usize) -> Vec<f32> {
    for start in (0..vectors.len()).step_by(length) {
        let (before, rest) = vectors.split_at_mut(start);
        let vector = &mut rest[..length];
        for other in before.chunks_exact(length) {
            let along = product(other, vector);
            vector.iter_mut().zip(other).for_each(|(x, other)| *x -= along * other);
        }
        let norm = product(vector, vector).sqrt();
        vector.iter_mut().for_each(|x| *x /= norm);
    }
    vectors
}

/// The product of two vectors, in eight sums that the compiler keeps apart.
fn product(one: &[f32], other: &[f32]) -> f32 {
    let (ones, others) = (one.as_chunks::<8>(), other.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (one, other) in ones.0.iter().zip(others.0) {
        sums.iter_mut().zip(one.iter().zip(other)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    let rest = ones.1.iter().zip(others.1).map(|(a, b)| a * b);
    sums.into_iter().chain(rest).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orthogonal_layers_keep_lengths() {
        for (input, output) in [(30, 12), (12, 30), (16, 16)] {
            let mut parameters = Parameters::default();
            let mut random = crate::random::stream(1, 1, 0);
            let layer = parameters.orthogonal("layer", input, output, &mut random);
            let weight = &parameters.values[layer.weight_range()];
            let entry = |row: usize, column: usize| weight[row * input + column];
            let vectors = input.min(output);
            for (one, other) in
                (0..vectors).flat_map(|one| (0..=one).map(move |other| (one, other)))
            {
                let product: f32 = if output > input {
                    (0..output).map(|row| entry(row, one) * entry(row, other)).sum()
                } else {
                    (0..input).map(|column| entry(one, column) * entry(other, column)).sum()
                };
                let want = f32::from(u8::from(one == other));
                assert!((product - want).abs() < 1e-5, "{input} {output} {one} {other} {product}");
            }
            assert!(parameters.values[layer.bias_range().unwrap()].iter().all(|it| *it == 0.0));
        }
    }
}
