//! The networks, on the tape: a body, two hidden layers over sparse inputs or convolutions as the public code of HAL has
//! them, and a head, the values of actions.

use sortie_core::options::{self, PictureShape};
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
    pub(crate) heads: Heads,
}

/// Values of all actions for each goal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heads {
    pub(crate) goals: usize,
    pub(crate) actions: usize,
    /// Whether they are a value of the state and advantages (Wang et al. 2016); they stand for themselves otherwise.
    pub(crate) dueling: bool,
}

impl Heads {
    pub(crate) fn outputs(self) -> usize {
        self.goals * (usize::from(self.dueling) + self.actions)
    }

    /// Of a head whose actions are these goals.
    pub(crate) fn of_goals(self, dueling: bool) -> Self {
        Self { goals: 1, actions: self.goals, dueling }
    }
}

/// The first of the largest numbers among those that a mask holds.
pub(crate) fn best(values: &[f32], mask: u32) -> usize {
    options::best(values, |index| mask >> index & 1 == 1).unwrap_or(0)
}

/// The layers of a network.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    pub(crate) heads: Heads,
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
    pub(crate) fn new(shape: NetworkShape, random: &mut Generator) -> (Self, Parameters) {
        let mut parameters = Parameters::default();
        let NetworkShape { body, picture, width, heads, .. } = shape;
        let (body, head) = match body {
            Body::Layers => Self::layers(&mut parameters, shape, random),
            Body::Convolution => {
                let body = Convolution::new(&mut parameters, picture, width, random);
                let head = parameters.orthogonal("head", width, heads.outputs(), random);
                (OwnBody::Convolution(body), head)
            }
        };
        (Self { heads, body, head }, parameters)
    }

    /// For inputs most of which are zero (He et al. 2015), with a head of small weights.
    fn layers(
        parameters: &mut Parameters,
        shape: NetworkShape,
        random: &mut Generator,
    ) -> (OwnBody, Linear) {
        let NetworkShape { columns, active, width, heads, .. } = shape;
        let mut layer = |name: &str, [input, output]: [usize; 2], is_sparse: bool, bound: f32| {
            let sizes = if is_sparse { [input, output] } else { [output, input] };
            let weight = parameters.tensor(&format!("{name}.weight"), &sizes, bound, random);
            let bias = Some(parameters.tensor(&format!("{name}.bias"), &[output], 0.0, random));
            Linear { shape: LinearShape { input, output }, weight, bias }
        };
        let he = |inputs: usize| (6.0 / inputs as f32).sqrt();
        let first = layer("first", [columns, width], true, he(active));
        let second = layer("second", [width, width], false, he(width));
        let bound = 0.1 / (width as f32).sqrt();
        (OwnBody::Layers([first, second]), layer("head", [width, heads.outputs()], false, bound))
    }

    /// The last hidden layer, `[rows, width]`.
    pub(crate) fn hidden(&self, pass: &mut Pass<'_>, rows: &SparseRows) -> Var {
        match &self.body {
            OwnBody::Layers([first, second]) => {
                let x = pass.sparse_linear_rectified(rows, *first);
                pass.linear_rectified(x, *second)
            }
            OwnBody::Convolution(body) => body.hidden(pass, rows),
        }
    }

    /// `[places, actions]`: what actions are worth by the last hidden layer, at [places](Self::place) of a row and a goal.
    pub(crate) fn values(&self, pass: &mut Pass<'_>, hidden: Var, places: &[u32]) -> Var {
        let Heads { goals, actions, dueling } = self.heads;
        let all = pass.linear(hidden, self.head);
        let at_places = |pass: &mut Pass<'_>, numbers: Var, columns: usize| {
            let by_goal = pass.reshape(numbers, columns);
            pass.gather(by_goal, places)
        };
        if !dueling {
            return at_places(pass, all, actions);
        }
        let values = pass.columns(all, 0..goals);
        let values = at_places(pass, values, 1);
        let advantages = pass.columns(all, goals..goals + goals * actions);
        let advantages = at_places(pass, advantages, actions);
        pass.dueling(values, advantages)
    }

    /// Where the values of a row for a goal are.
    pub(crate) fn place(&self, row: usize, goal: usize) -> u32 {
        (row * self.heads.goals + goal) as u32
    }

    /// The layers by these weights, as they are deployed; none of convolutions.
    pub(crate) fn dense(&self, weights: &[f32]) -> Option<[DenseLayer; 3]> {
        let OwnBody::Layers([first, second]) = self.body else { return None };
        let mut layers = [first, second, self.head].map(|layer| DenseLayer::of(layer, weights));
        // The first layer sums up rows of columns that differ from zero; it stands turned.
        let (output, turned) = (first.shape.output, std::mem::take(&mut layers[0].weight));
        let own = |number: usize| turned.iter().skip(number).step_by(output);
        layers[0].weight = (0..output).flat_map(own).copied().collect();
        Some(layers)
    }

    pub(crate) fn width(&self) -> usize {
        self.head.shape.input
    }
}

/// Rows of a pass: what fits beside the weights into the caches.
const ROWS: usize = 128;

/// Memory of passes without gradients.
#[derive(Debug, Default)]
pub(crate) struct Space {
    tape: Tape,
    rows: SparseRows,
    places: Vec<u32>,
    found: Vec<f32>,
}

impl Space {
    /// `[states, actions]`: what actions are worth, for the bytes of states and a goal each.
    pub(crate) fn values<'s>(
        &mut self,
        (network, weights): (&Network, &[f32]),
        shown: &Shown,
        states: impl Iterator<Item = (&'s [u8], usize)>,
    ) -> &[f32] {
        self.run((network, weights), shown, states, |pass, hidden, places| {
            network.values(pass, hidden, places)
        })
    }

    /// `[states, width]`: the last hidden layer.
    pub(crate) fn hidden<'s>(
        &mut self,
        network: (&Network, &[f32]),
        shown: &Shown,
        states: impl Iterator<Item = &'s [u8]>,
    ) -> &[f32] {
        self.run(network, shown, states.map(|state| (state, 0)), |_, hidden, _| hidden)
    }

    fn run<'s>(
        &mut self,
        (network, weights): (&Network, &[f32]),
        shown: &Shown,
        states: impl Iterator<Item = (&'s [u8], usize)>,
        read: impl Fn(&mut Pass<'_>, Var, &[u32]) -> Var,
    ) -> &[f32] {
        let Self { tape, rows, places, found } = self;
        found.clear();
        let mut states = states.peekable();
        while states.peek().is_some() {
            rows.clear();
            places.clear();
            for (row, (bytes, goal)) in states.by_ref().take(ROWS).enumerate() {
                shown.push(bytes, false, rows);
                places.push(network.place(row, goal));
            }
            let mut pass = tape.begin(weights);
            let hidden = network.hidden(&mut pass, rows);
            let read = read(&mut pass, hidden, places);
            found.extend_from_slice(pass.values(read));
        }
        found
    }
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
                let heads = Heads { goals: 1, actions: 1, dueling: false };
                let (body, columns, active) = (Body::Convolution, 0, 0);
                let shape = NetworkShape { body, picture, columns, active, width, heads };
                Network::new(shape, &mut stream(1, 1, 0)).1.values.len() - (width + 1)
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

    #[test]
    fn values_are_those_of_the_numbers_of_a_head_and_have_their_gradient() {
        for dueling in [true, false] {
            let heads = Heads { goals: 3, actions: 4, dueling };
            assert_eq!(heads.outputs(), if dueling { 15 } else { 12 });
            let (body, columns, active, width) = (Body::Layers, 5, 5, 8);
            let shape = NetworkShape { body, picture: PICTURE, columns, active, width, heads };
            let (network, parameters) = Network::new(shape, &mut stream(1, 1, 0));
            let (hidden, places) = (random(2, 16), [(0, 2), (0, 1), (1, 2)]);
            let find = |weights: &[f32], gradient: Option<&mut [f32]>| {
                let mut tape = Tape::default();
                let mut pass = tape.begin(weights);
                let hidden = pass.input(8, &hidden);
                let places = places.map(|(row, goal)| network.place(row, goal));
                let values = network.values(&mut pass, hidden, &places);
                let found = pass.values(values).to_vec();
                let loss = pass.squared_error(values, &random(7, 12), 0.5);
                let loss_of = f64::from(pass.values(loss)[0]);
                gradient.into_iter().for_each(|gradient| pass.backward(loss, gradient));
                (found, loss_of)
            };
            let mut gradient = vec![0.0; parameters.values.len()];
            let (found, _) = find(&parameters.values, Some(&mut gradient));
            assert_gradient("values", &parameters.values, &gradient, |it| find(it, None).1);
            for ((row, goal), found) in places.into_iter().zip(found.chunks_exact(4)) {
                let hidden = &hidden[8 * row..][..8];
                let want = naive::values((&network, &parameters.values), hidden, goal);
                for (want, found) in want.iter().zip(found) {
                    assert!((want - found).abs() < 1e-6, "{want} {found}");
                }
            }
        }
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0], 0b1101), 2);
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0], u32::MAX), 1);
    }
}

/// Values number by number, for tests.
#[cfg(test)]
pub(crate) mod naive {
    use super::*;

    /// What a head makes of a hidden row for a goal: the value and advantages less their mean, or the values themselves.
    pub(crate) fn values(
        (network, weights): (&Network, &[f32]),
        hidden: &[f32],
        goal: usize,
    ) -> Vec<f32> {
        let Heads { goals, actions, dueling } = network.heads;
        let bias = &weights[network.head.bias_range().unwrap()];
        let number = |output: usize| {
            let row = &weights[network.head.weight + output * hidden.len()..];
            bias[output] + row.iter().zip(hidden).map(|(weight, x)| weight * x).sum::<f32>()
        };
        let first = goal * actions + if dueling { goals } else { 0 };
        let all: Vec<f32> = (first..first + actions).map(number).collect();
        let mean = all.iter().sum::<f32>() / actions as f32;
        let level = if dueling { number(goal) - mean } else { 0.0 };
        all.iter().map(|it| it + level).collect()
    }
}
