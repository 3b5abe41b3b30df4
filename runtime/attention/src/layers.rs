//! Layers of networks as numbers.

use alloc::vec;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

/// A matrix `[inputs, outputs]`, row-major.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Matrix {
    /// Rows.
    pub inputs: usize,
    /// Columns.
    pub outputs: usize,
    /// The weights.
    pub values: Vec<f32>,
}

impl Matrix {
    /// The product of one input row and this matrix.
    pub fn apply(&self, input: &[f32]) -> Vec<f32> {
        let mut output = vec![0.0; self.outputs];
        for (factor, row) in input.iter().zip(self.values.chunks_exact(self.outputs)) {
            output.iter_mut().zip(row).for_each(|(sum, weight)| *sum += factor * weight);
        }
        output
    }

    /// Some columns: the outputs from `start` on.
    pub fn columns(&self, start: usize, count: usize) -> Self {
        let rows = self.values.chunks_exact(self.outputs);
        let values = rows.flat_map(|row| row.iter().skip(start).take(count)).copied().collect();
        Self { inputs: self.inputs, outputs: count, values }
    }

    /// The matrix with inputs and outputs exchanged.
    pub fn transposed(&self) -> Self {
        let column = |column: usize| self.values.iter().skip(column).step_by(self.outputs);
        let values = (0..self.outputs).flat_map(column).copied().collect();
        Self { inputs: self.outputs, outputs: self.inputs, values }
    }
}

/// A matrix with its bias, and whether a ReLU follows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// The weights.
    pub matrix: Matrix,
    /// The bias `[outputs]`.
    pub bias: Vec<f32>,
    /// Whether negative outputs become zero.
    pub relu: bool,
}

impl Layer {
    /// The layer's output for one input row.
    pub fn apply(&self, input: &[f32]) -> Vec<f32> {
        let mut output = self.matrix.apply(input);
        for (value, bias) in output.iter_mut().zip(&self.bias) {
            *value += bias;
            if self.relu {
                *value = value.max(0.0);
            }
        }
        output
    }
}
