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
