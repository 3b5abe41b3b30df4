//! The networks: a body, two hidden layers over sparse inputs or convolutions as the public code of HAL has them, and a
//! head.

use sortie_core::options::PictureShape;
use sortie_learn::export::DenseLayer;
use sortie_learn::words;
use sortie_nn::layers::SparseRows;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::layers::unfold::UnfoldShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Tape, Var};

use super::Shown;

words! {
    /// What stands below a head.
    Body {
        /// Two layers over inputs most of which are zero.
        Layers = "layers",
        /// Convolutions over the picture, as published.
        Convolution = "convolution",
    }
}

impl Body {
    /// The least side of a picture that convolutions go over.
    pub(crate) const SIDE: usize = Convolution::SIDE;
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct NetworkShape {
    pub(crate) body: Body,
    /// What is shown.
    pub(crate) picture: PictureShape,
    pub(crate) columns: usize,
    /// Those of them that differ from zero, which the first weights are sized for.
    pub(crate) active: usize,
    pub(crate) width: usize,
    pub(crate) outputs: usize,
}

/// A network, and how its head is read.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    /// The first weights that were drawn, and their names.
    pub(crate) parameters: Parameters,
    body: OwnBody,
    head: Linear,
}

#[derive(Clone, Debug)]
enum OwnBody {
    Layers([Linear; 2]),
    Convolution(Convolution),
}

impl Network {
    /// Draws the first weights, as the body asks for.
    pub(crate) fn new(shape: NetworkShape, random: &mut Generator) -> Self {
        match shape.body {
            Body::Layers => Self::of_layers(shape, random),
            Body::Convolution => {
                let mut parameters = Parameters::default();
                let NetworkShape { picture, width, outputs, .. } = shape;
                let body = Convolution::new(&mut parameters, picture, width, random);
                let head = parameters.orthogonal("head", width, outputs, random);
                Self { parameters, body: OwnBody::Convolution(body), head }
            }
        }
    }

    /// Draws the first weights: for inputs most of which are zero (He et al. 2015), small ones for the head.
    fn of_layers(shape: NetworkShape, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let NetworkShape { columns, active, width, outputs, .. } = shape;
        let mut layer = |name: &str, shape: [usize; 2], sizes: [usize; 2], bound: f32| {
            let weight = parameters.tensor(&format!("{name}.weight"), &shape, bound, random);
            let bias = parameters.tensor(&format!("{name}.bias"), &[sizes[1]], 0.0, random);
            let shape = LinearShape { input: sizes[0], output: sizes[1] };
            Linear { shape, weight, bias: Some(bias) }
        };
        let he = |inputs: usize| (6.0 / inputs as f32).sqrt();
        let first = layer("first", [columns, width], [columns, width], he(active));
        let second = layer("second", [width, width], [width, width], he(width));
        let bound = 0.1 / (width as f32).sqrt();
        let head = layer("head", [outputs, width], [width, outputs], bound);
        Self { parameters, body: OwnBody::Layers([first, second]), head }
    }

    /// The last hidden layer, `[rows, width]`.
    pub(crate) fn hidden(&self, pass: &mut Pass<'_>, rows: &SparseRows) -> Var {
        match &self.body {
            OwnBody::Layers([first, second]) => {
                let x = pass.sparse_linear(rows, *first);
                let x = pass.relu(x);
                pass.linear_rectified(x, *second)
            }
            OwnBody::Convolution(body) => body.hidden(pass, rows),
        }
    }

    /// What the head makes of it, `[rows, outputs]`.
    pub(crate) fn head(&self, pass: &mut Pass<'_>, hidden: Var) -> Var {
        pass.linear(hidden, self.head)
    }

    /// The layers by these weights, as they are deployed; none of convolutions.
    pub(crate) fn dense(&self, weights: &[f32]) -> Option<[DenseLayer; 3]> {
        let OwnBody::Layers([first, second]) = self.body else { return None };
        Some([first, second, self.head].map(|layer| {
            let LinearShape { input, output } = layer.shape;
            let part = |start: usize, length: usize| weights[start..start + length].to_vec();
            let weight = part(layer.weight, input * output);
            let bias = part(layer.bias.expect("every layer has one"), output);
            // The first layer sums up rows of columns that differ from zero; it stands turned.
            let is_turned = layer == first;
            let own = |output_: usize| weight.iter().skip(output_).step_by(output).copied();
            let weight = if is_turned { (0..output).flat_map(own).collect() } else { weight };
            DenseLayer { inputs: input, weight, bias }
        }))
    }

    pub(crate) fn outputs(&self) -> usize {
        self.head.shape.output
    }

    pub(crate) fn width(&self) -> usize {
        self.head.shape.input
    }

    /// Some numbers of the head by weights `[outputs, width]` of a hidden row.
    pub(crate) fn read(
        &self,
        weights: &[f32],
        hidden: &[f32],
        outputs: impl Iterator<Item = usize>,
        to: &mut [f32],
    ) {
        let bias = self.head.bias.expect("every layer has one");
        for (to, output) in to.iter_mut().zip(outputs) {
            let row = &weights[self.head.weight + output * hidden.len()..][..hidden.len()];
            *to = weights[bias + output] + dot(row, hidden);
        }
    }
}

/// The product of two rows, in eight sums that the compiler keeps apart.
fn dot(one: &[f32], other: &[f32]) -> f32 {
    let mut sums = [0.0; 8];
    for (one, other) in one.chunks_exact(8).zip(other.chunks_exact(8)) {
        for (sum, (one, other)) in sums.iter_mut().zip(one.iter().zip(other)) {
            *sum += one * other;
        }
    }
    sums.iter().sum()
}

/// Rows of a pass: what fits beside the weights into the caches.
const ROWS: usize = 128;

/// Memory of passes without gradients, and of the rows that are shown.
#[derive(Debug, Default)]
pub(crate) struct Space {
    pub(crate) tape: Tape,
    pub(crate) rows: SparseRows,
    hidden: Vec<f32>,
}

impl Space {
    /// The last hidden layer `[states, width]` for the bytes of states.
    pub(crate) fn hidden<'s>(
        &mut self,
        network: &Network,
        weights: &[f32],
        shown: &Shown,
        states: impl Iterator<Item = (&'s [u8], bool)>,
    ) -> &[f32] {
        self.hidden.clear();
        let mut states = states.peekable();
        while states.peek().is_some() {
            self.rows.clear();
            for (bytes, is_mirrored) in states.by_ref().take(ROWS) {
                shown.push(bytes, is_mirrored, &mut self.rows);
            }
            let mut pass = self.tape.begin(weights);
            let hidden = network.hidden(&mut pass, &self.rows);
            self.hidden.extend_from_slice(pass.values(hidden));
        }
        &self.hidden
    }

    /// The same for rows of columns.
    pub(crate) fn hidden_of(
        &mut self,
        network: &Network,
        weights: &[f32],
        rows: &SparseRows,
    ) -> &[f32] {
        let mut pass = self.tape.begin(weights);
        let hidden = network.hidden(&mut pass, rows);
        self.hidden.clear();
        self.hidden.extend_from_slice(pass.values(hidden));
        &self.hidden
    }
}

/// A number whose slopes by a matrix are these: what a loss that was computed by hand tells a tape.
pub(crate) fn slopes(pass: &mut Pass<'_>, x: Var, slopes: &[f32]) -> Var {
    let columns = pass.size(x)[1];
    let given = pass.input(columns, slopes);
    let product = pass.multiply(x, given);
    let sums = pass.sum_columns(product);
    pass.sum_rows(sums)
}

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

    use super::*;
    use crate::pictures::heads::Heads;

    #[test]
    fn published_networks_have_as_many_weights_as_published() {
        // Channels, things carried, milestones and actions of crafting up to diamond, up to iron, and of treasure, with
        // the weights of controller, meta-controller, embedding, and classes.
        for (channels, counts, goals, actions, want) in [
            (11, 12, 13, 11, [1_458_524, 1_385_678, 266_816, 1_677]),
            (11, 12, 11, 11, [1_446_212, 1_384_652, 266_816, 1_419]),
            (18, 7, 10, 5, [1_412_316, 1_387_179, 271_776, 1_290]),
        ] {
            let picture = PictureShape { channels, size: 11, counts, crop: 11, nearest: false };
            let controller = Heads { goals, actions, dueling: true };
            let body = |width: usize| {
                let (body, columns, active, outputs) = (Body::Convolution, 0, 0, 1);
                let shape = NetworkShape { body, picture, columns, active, width, outputs };
                let mut random = sortie_nn::random::stream(1, 1, 0);
                let network = Network::new(shape, &mut random);
                network.parameters.values.len() - (width + 1)
            };
            let (wide, embedding) = (body(512), body(128));
            let found = [
                wide + controller.outputs() * 513,
                wide + controller.of_goals(true).outputs() * 513,
                embedding,
                goals * 129,
            ];
            assert_eq!(found, want, "{channels} {goals}");
        }
    }

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
