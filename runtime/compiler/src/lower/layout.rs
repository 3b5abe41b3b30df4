//! Weights as a plan stores them: layout 1, tiles of up to 64 columns.

use sortie_core::internal::kernels::product::{padded, tile_width};
use sortie_core::internal::ops::{Linear, Vectors};

use crate::matching::{Layer, Matrix};

/// Floats that every part starts at a multiple of: one cache line.
const ALIGN: usize = 16;

/// The weights of a plan, part after part.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub(crate) floats: Vec<f32>,
}

impl Weights {
    /// The weights as a plan holds them.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        self.floats.iter().flat_map(|weight| weight.to_le_bytes()).collect()
    }

    /// Adds a layer, its columns in tiles, matrix and bias padded with zeros.
    pub(crate) fn add_layer(&mut self, layer: &Layer) -> Linear {
        let Matrix { inputs, outputs, .. } = layer.matrix;
        let weights = self.add_matrices(&[&layer.matrix]);
        let bias = self.align();
        // Adding zero turns -0 into +0: sums that never are -0 may leave out terms of ±0.
        self.floats.extend(layer.bias.iter().map(|bias| bias + 0.0));
        self.floats.resize(bias + padded(outputs), 0.0);
        Linear { inputs: inputs as u16, outputs: outputs as u16, weights, bias: bias as u32 }
    }

    /// Adds matrices of the same size one behind the other and returns where the first starts.
    pub(crate) fn add_matrices(&mut self, matrices: &[&Matrix]) -> u32 {
        let start = self.align();
        for matrix in matrices {
            let mut column = 0;
            while column < matrix.outputs {
                let width = tile_width(padded(matrix.outputs) - column);
                for row in matrix.values.chunks_exact(matrix.outputs) {
                    let tile = row.iter().skip(column).chain(std::iter::repeat(&0.0)).take(width);
                    self.floats.extend(tile);
                }
                column += width;
            }
        }
        start as u32
    }

    /// Adds the rows of a matrix as vectors, each padded with zeros.
    pub(crate) fn add_vectors(&mut self, rows: &Matrix) -> Vectors {
        let Matrix { inputs: count, outputs: width, values } = rows;
        let start = self.align();
        for row in values.chunks_exact(*width) {
            self.floats.extend(row);
            self.floats.resize(self.floats.len() + padded(*width) - width, 0.0);
        }
        Vectors { weights: start as u32, count: *count as u16, width: *width as u16 }
    }

    /// Adds numbers as they are.
    pub(crate) fn add_numbers(&mut self, numbers: &[f32]) -> u32 {
        let start = self.align();
        self.floats.extend(numbers);
        start as u32
    }

    fn align(&mut self) -> usize {
        self.floats.resize(self.floats.len().next_multiple_of(ALIGN), 0.0);
        self.floats.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_go_to_tiles_and_padding_is_zero() {
        let value = |row: usize, column: usize| (100 * row + column) as f32;
        let values = (0..2).flat_map(|row| (0..75).map(move |column| value(row, column))).collect();
        let layer = Layer {
            matrix: Matrix { inputs: 2, outputs: 75, values },
            bias: vec![-0.0; 75],
            relu: false,
        };
        let mut weights = Weights::default();
        let linear = weights.add_layer(&layer);
        assert_eq!((linear.weights_len(), linear.bias as usize), (2 * 80, 2 * 80));
        let at = |index: usize| weights.floats[index];
        assert_eq!((at(0), at(63), at(64)), (value(0, 0), value(0, 63), value(1, 0)));
        // The rest of 16 padded columns is one tile.
        assert_eq!((at(128), at(138), at(139)), (value(0, 64), value(0, 74), 0.0));
        assert_eq!((at(144), at(154), at(155)), (value(1, 64), value(1, 74), 0.0));
        assert!(weights.floats[160..].iter().all(|bias| bias.to_bits() == 0));
    }
}
