//! Weights as an int8 plan stores them: layout 2, strips of 16 columns, pairs of inputs side by side.

use sortie_core::internal::kernels::int8::{PAIRS, STRIP};
use sortie_core::internal::ops::Int8Layer;

use super::rounding::Rounded;

/// Bytes that every part starts at a multiple of: one cache line.
const ALIGN: usize = 64;

/// In which order rows of weights are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// All pairs of a strip, then the next strip.
    Strips,
    /// All strips of a pair, then the next pair: for inputs of which few are not zero.
    Pairs,
}

/// The weights of a plan, part after part.
#[derive(Clone, Debug, Default)]
pub(crate) struct Int8Weights {
    pub(crate) bytes: Vec<u8>,
}

impl Int8Weights {
    /// Adds a layer: its matrix, what the weights count, its bias.
    pub(crate) fn add_layer(&mut self, layer: &Rounded, order: Order) -> Int8Layer {
        let Rounded { inputs, outputs, .. } = *layer;
        let (weights, steps) = self.add_matrices(std::slice::from_ref(layer), order);
        let bias = self.add_floats(&layer.bias);
        Int8Layer { inputs: inputs as u16, outputs: outputs as u16, weights, steps, bias }
    }

    /// Adds matrices of the same size one behind the other, then their steps; returns where both start, in floats.
    pub(crate) fn add_matrices(&mut self, matrices: &[Rounded], order: Order) -> (u32, u32) {
        let start = self.align();
        let mut all_steps = Vec::new();
        for matrix in matrices {
            self.add_rows(matrix, order);
            all_steps.extend(&matrix.steps);
            all_steps.resize(all_steps.len().next_multiple_of(STRIP), 0.0);
        }
        (start, self.add_floats(&all_steps))
    }

    fn add_rows(&mut self, matrix: &Rounded, order: Order) {
        let pairs = matrix.inputs.div_ceil(2).next_multiple_of(PAIRS);
        let strips = matrix.outputs.div_ceil(STRIP);
        let weight = |input: usize, output: usize| match matrix
            .integers
            .get(input * matrix.outputs + output)
        {
            Some(integer) if output < matrix.outputs => *integer,
            _ => 0,
        };
        let mut add = |pair: usize, strip: usize| {
            for output in strip * STRIP..(strip + 1) * STRIP {
                let both = [2 * pair, 2 * pair + 1].map(|input| weight(input, output) as u8);
                self.bytes.extend(both);
            }
        };
        match order {
            Order::Strips => {
                (0..strips).for_each(|strip| (0..pairs).for_each(|pair| add(pair, strip)))
            }
            Order::Pairs => {
                (0..pairs).for_each(|pair| (0..strips).for_each(|strip| add(pair, strip)))
            }
        }
    }

    /// Adds numbers, zeros behind them up to whole strips.
    pub(crate) fn add_floats(&mut self, floats: &[f32]) -> u32 {
        let start = self.align();
        let zeros = floats.len().next_multiple_of(STRIP) - floats.len();
        // Adding zero turns -0 into +0.
        let bytes = floats.iter().flat_map(|float| (float + 0.0).to_le_bytes());
        self.bytes.extend(bytes.chain(std::iter::repeat_n(0, 4 * zeros)));
        start
    }

    fn align(&mut self) -> u32 {
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGN), 0);
        (self.bytes.len() / 4) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer() -> Rounded {
        let integers = [-127, 0, 127].iter().flat_map(|weight| [*weight; 18]).collect();
        let steps = (1..=18).map(|output| output as f32 / 127.0).collect();
        Rounded { inputs: 3, outputs: 18, integers, steps, bias: vec![-0.0; 18] }
    }

    #[test]
    fn rows_stand_where_the_format_says() {
        // Inputs 0, 1 and 2 weigh -127, 0 and 127 for every output; there is no input 3 or beyond.
        let both = |pair: usize| [[129, 0], [127, 0], [0, 0], [0, 0]][pair];
        for order in [Order::Strips, Order::Pairs] {
            let place = |row: usize| match order {
                Order::Strips => (row % 4, row / 4),
                Order::Pairs => (row / 2, row % 2),
            };
            let places = (0..8).map(place);
            let mut weights = Int8Weights::default();
            let added = weights.add_layer(&layer(), order);
            assert_eq!((added.weights, added.steps, added.bias), (0, 64, 96));
            for (row, (pair, strip)) in weights.bytes.chunks(32).zip(places) {
                for (column, got) in row.chunks(2).enumerate() {
                    let exists = strip * STRIP + column < 18;
                    assert_eq!(got, if exists { both(pair) } else { [0; 2] }, "{order:?}");
                }
            }
            let float = |index: usize| {
                f32::from_le_bytes(*weights.bytes[4 * index..].first_chunk().unwrap())
            };
            assert_eq!((float(64), float(81), float(82)), (1.0 / 127.0, 18.0 / 127.0, 0.0));
            assert!(weights.bytes[384..].iter().all(|byte| *byte == 0));
        }
    }
}
