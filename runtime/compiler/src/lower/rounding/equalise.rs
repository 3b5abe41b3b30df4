//! Scales moved between neighbouring products, so that the weights of one output are of like size.
//!
//! All weights of an output count in the same step, so that the largest decides how coarse the others become. Where
//! one product's outputs are the next one's inputs, with nothing or a ReLU between them, an output may be multiplied and
//! the next product's weights of it divided by the same: the network stays what it is. Powers of two change no bit.

use super::products::{EMBED, Products, QUERY};
use crate::matching::Layer;

/// Moves scales in a whole network, from the first product to the last.
pub(crate) fn equalise(products: &mut Products) {
    let head_width = products.head_width();
    let inner = products.heads * head_width;
    let skips = products.layers[products.output()].matrix.inputs > inner;
    for unit in 0..products.layers[EMBED].matrix.outputs {
        let takers = products.values().chain([QUERY]).map(|index| (index, unit));
        let skip = skips.then_some((products.output(), inner + unit));
        let takers: Vec<(usize, usize)> = takers.chain(skip).collect();
        let scale = scale(products, &takers);
        products.layers[EMBED].scale_output(unit, scale);
        // Scores are products of rows and absorbed keys.
        products.keys().for_each(|keys| products.layers[keys].scale_output(unit, 1.0 / scale));
        for (index, input) in takers {
            products.layers[index].scale_input(input, 1.0 / scale);
        }
    }
    for (head, (keys, values)) in products.keys().zip(products.values()).enumerate() {
        for unit in 0..head_width {
            let place = head * head_width + unit;
            pass(products, (QUERY, place), (keys, unit));
            // What a narrower head has beyond its width is zero.
            if unit < products.layers[values].matrix.outputs {
                pass(products, (values, unit), (products.output(), place));
            }
        }
    }
    for index in products.output()..products.layers.len() - 1 {
        for unit in 0..products.layers[index].matrix.outputs {
            pass(products, (index, unit), (index + 1, unit));
        }
    }
}

/// Moves the scale of an output, `(product, output)`, to the input that it is, `(product, input)`.
fn pass(products: &mut Products, from: (usize, usize), to: (usize, usize)) {
    let scale = scale(products, &[to]);
    products.layers[from.0].scale_output(from.1, scale);
    products.layers[to.0].scale_input(to.1, 1.0 / scale);
}

/// The power of two next to the largest weight of an input, in all products that take it; 1 where there is none.
fn scale(products: &Products, takers: &[(usize, usize)]) -> f32 {
    let weights = takers.iter().flat_map(|&(index, input)| products.layers[index].of_input(input));
    let largest = weights.fold(0.0_f32, |largest, weight| largest.max(weight.abs()));
    if !(1.0e-6..1.0e6).contains(&largest) {
        return 1.0;
    }
    // Without its fraction, a number times the root of two is the power of two that is nearer in ratio.
    f32::from_bits((largest * std::f32::consts::SQRT_2).to_bits() & 0x7f80_0000)
}

trait Scaled {
    fn of_input(&self, input: usize) -> &[f32];
    fn scale_input(&mut self, input: usize, by: f32);
    fn scale_output(&mut self, output: usize, by: f32);
}

impl Scaled for Layer {
    fn of_input(&self, input: usize) -> &[f32] {
        let outputs = self.matrix.outputs;
        &self.matrix.values[input * outputs..(input + 1) * outputs]
    }

    fn scale_input(&mut self, input: usize, by: f32) {
        let outputs = self.matrix.outputs;
        let weights = &mut self.matrix.values[input * outputs..(input + 1) * outputs];
        weights.iter_mut().for_each(|weight| *weight *= by);
    }

    fn scale_output(&mut self, output: usize, by: f32) {
        let weights = self.matrix.values.iter_mut().skip(output).step_by(self.matrix.outputs);
        weights.chain(self.bias.get_mut(output)).for_each(|weight| *weight *= by);
    }
}
