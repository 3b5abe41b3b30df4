//! A body of convolutions, as the public code of HAL has it.

use sortie_core::options::PictureShape;
use sortie_nn::layers::SparseRows;
use sortie_nn::layers::unfold::UnfoldShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

/// Sides and numbers of the kernels.
const KERNELS: [(usize, usize); 2] = [(5, 32), (3, 64)];

/// Two convolutions over the picture beside a layer over what is carried, and one over both.
#[derive(Clone, Debug)]
pub(super) struct Convolution {
    kernels: [(UnfoldShape, Linear); 2],
    flat: Linear,
    carried: Linear,
    joint: Linear,
}

impl Convolution {
    /// The least side of a picture that the kernels fit into.
    pub(super) const SIDE: usize = 7;

    /// Draws the first weights, orthogonal ones; offsets are 0.
    pub(super) fn new(
        parameters: &mut Parameters,
        picture: PictureShape,
        width: usize,
        random: &mut Generator,
    ) -> Self {
        let (mut side, mut channels) = (picture.crop, picture.channels);
        let kernels = KERNELS.map(|(kernel, outputs)| {
            let shape = UnfoldShape { height: side, width: side, channels, kernel, stride: 1 };
            let name = format!("kernel-{kernel}");
            let layer = parameters.orthogonal(&name, shape.patch(), outputs, random);
            (side, channels) = (shape.patches().0, outputs);
            (shape, layer)
        });
        let mut layer =
            |name: &str, inputs: usize| parameters.orthogonal(name, inputs, width, random);
        let flat = layer("flat", side * side * channels);
        let carried = layer("carried", picture.counts);
        Self { kernels, flat, carried, joint: layer("joint", 2 * width) }
    }

    /// `[rows, width]`: what it makes of rows of a picture and counts.
    pub(super) fn hidden(&self, pass: &mut Pass<'_>, rows: &SparseRows) -> Var {
        let (cells, counts) = (self.kernels[0].0.picture(), self.carried.shape.input);
        let mut pictures = vec![0.0; rows.len() * cells];
        let mut carried = vec![0.0; rows.len() * counts];
        for row in 0..rows.len() {
            for (column, number) in rows.row(row) {
                match column.checked_sub(cells) {
                    None => pictures[row * cells + column] = number,
                    Some(item) => carried[row * counts + item] = number,
                }
            }
        }
        let mut x = pass.input(cells, &pictures);
        for (shape, layer) in self.kernels {
            x = pass.convolution(x, shape, layer);
            x = pass.relu(x);
        }
        let x = pass.linear_rectified(x, self.flat);
        let carried = pass.input(counts, &carried);
        let carried = pass.linear_rectified(carried, self.carried);
        let both = pass.concat(&[x, carried]);
        pass.linear_rectified(both, self.joint)
    }
}

#[cfg(test)]
mod tests {
    use sortie_nn::gradient_check::{assert_gradient, random};
    use sortie_nn::random::stream;
    use sortie_nn::tape::Tape;

    use super::*;

    const PICTURE: PictureShape =
        PictureShape { channels: 2, size: 9, counts: 3, crop: 7, nearest: false };

    fn small() -> (Parameters, Convolution) {
        let (mut parameters, mut random) = (Parameters::default(), stream(1, 1, 0));
        let body = Convolution::new(&mut parameters, PICTURE, 8, &mut random);
        // Offsets that are not 0 are checked as well.
        let shifts = sortie_nn::gradient_check::random(5, parameters.values.len());
        parameters.values.iter_mut().zip(shifts).for_each(|(weight, shift)| *weight += 0.1 * shift);
        (parameters, body)
    }

    fn rows() -> SparseRows {
        let mut rows = SparseRows::default();
        let numbers = random(3, 3 * 101);
        for row in numbers.chunks_exact(101) {
            let entries = row.iter().enumerate().filter(|(column, x)| **x > 0.5 || *column == 99);
            entries.for_each(|(column, x)| rows.push(column, *x));
            rows.end_row();
        }
        rows
    }

    #[test]
    fn a_body_is_what_naive_loops_say() {
        let (parameters, body) = small();
        let (rows, mut tape) = (rows(), Tape::default());
        let mut pass = tape.begin(&parameters.values);
        let hidden = body.hidden(&mut pass, &rows);
        let found = pass.values(hidden);
        let weight = |layer: Linear, output: usize, input: usize| {
            parameters.values[layer.weight + output * layer.shape.input + input]
        };
        let bias = |layer: Linear, output: usize| parameters.values[layer.bias.unwrap() + output];
        let dense = |layer: Linear, x: &[f32]| -> Vec<f32> {
            let sum = |output| {
                let products =
                    x.iter().enumerate().map(|(input, x)| x * weight(layer, output, input));
                (bias(layer, output) + products.sum::<f32>()).max(0.0)
            };
            (0..layer.shape.output).map(sum).collect()
        };
        let convolved = |layer: Linear, x: &[f32], [side, channels, kernel]: [usize; 3]| {
            let (count, mut y) = (side - kernel + 1, Vec::new());
            for (down, across) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
                let mut patch = Vec::new();
                for (i, j) in (0..kernel).flat_map(|i| (0..kernel).map(move |j| (i, j))) {
                    let cell = (down + i) * side + across + j;
                    patch.extend_from_slice(&x[cell * channels..][..channels]);
                }
                y.extend(dense(layer, &patch));
            }
            y
        };
        for row in 0..3 {
            let mut x = vec![0.0; 101];
            rows.row(row).for_each(|(column, number)| x[column] = number);
            let (cells, counts) = x.split_at(98);
            let y = convolved(body.kernels[0].1, cells, [7, 2, 5]);
            let y = convolved(body.kernels[1].1, &y, [3, 32, 3]);
            let mut both = dense(body.flat, &y);
            both.extend(dense(body.carried, counts));
            for (want, found) in dense(body.joint, &both).iter().zip(&found[8 * row..]) {
                assert!((want - found).abs() < 1e-4, "{want} {found}");
            }
        }
    }

    #[test]
    fn gradients_of_a_body_agree_with_finite_differences() {
        let (parameters, body) = small();
        let rows = rows();
        let loss = |weights: &[f32], gradient: Option<&mut [f32]>| {
            let mut tape = Tape::default();
            let mut pass = tape.begin(weights);
            let hidden = body.hidden(&mut pass, &rows);
            let loss = pass.squared_error(hidden, &random(7, 24), 0.5);
            let found = f64::from(pass.values(loss)[0]);
            gradient.into_iter().for_each(|gradient| pass.backward(loss, gradient));
            found
        };
        let mut gradient = vec![0.0; parameters.values.len()];
        loss(&parameters.values, Some(&mut gradient));
        for tensor in parameters.tensors() {
            let (at, own) = (&parameters.values[tensor.range.clone()], tensor.range.clone());
            assert_gradient(&tensor.name, at, &gradient[own.clone()], |part| {
                let mut weights = parameters.values.clone();
                weights[own.clone()].copy_from_slice(part);
                loss(&weights, None)
            });
        }
    }
}
