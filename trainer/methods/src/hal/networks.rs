//! The networks: two hidden layers over sparse inputs, and a head.

use sortie_learn::export::DenseLayer;
use sortie_nn::layers::SparseRows;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Tape, Var};

use super::config::NetworkConfig;
use super::shown::Shown;

/// A network, and how its head is read.
#[derive(Clone, Debug)]
pub(super) struct Network {
    /// The first weights that were drawn, and their names.
    pub(super) parameters: Parameters,
    layers: [Linear; 3],
}

impl Network {
    /// Draws the first weights: for inputs most of which are zero (He et al. 2015), small ones for the head.
    pub(super) fn new(
        config: &NetworkConfig,
        columns: usize,
        outputs: usize,
        random: &mut Generator,
    ) -> Self {
        let mut parameters = Parameters::default();
        let width = config.width;
        let mut layer = |name: &str, shape: [usize; 2], sizes: [usize; 2], bound: f32| {
            let weight = parameters.tensor(&format!("{name}.weight"), &shape, bound, random);
            let bias = parameters.tensor(&format!("{name}.bias"), &[sizes[1]], 0.0, random);
            let shape = LinearShape { input: sizes[0], output: sizes[1] };
            Linear { shape, weight, bias: Some(bias) }
        };
        let he = |inputs: usize| (6.0 / inputs as f32).sqrt();
        let first = layer("first", [columns, width], [columns, width], he(config.active_inputs));
        let second = layer("second", [width, width], [width, width], he(width));
        let bound = 0.1 / (width as f32).sqrt();
        let head = layer("head", [outputs, width], [width, outputs], bound);
        Self { layers: [first, second, head], parameters }
    }

    /// The second hidden layer, `[rows, width]`.
    pub(super) fn hidden(&self, pass: &mut Pass<'_>, rows: &SparseRows) -> Var {
        let x = pass.sparse_linear(rows, self.layers[0]);
        let x = pass.relu(x);
        pass.linear_rectified(x, self.layers[1])
    }

    /// What the head makes of it, `[rows, outputs]`.
    pub(super) fn head(&self, pass: &mut Pass<'_>, hidden: Var) -> Var {
        pass.linear(hidden, self.layers[2])
    }

    /// The layers by these weights, as they are deployed.
    pub(super) fn dense(&self, weights: &[f32]) -> [DenseLayer; 3] {
        self.layers.map(|layer| {
            let LinearShape { input, output } = layer.shape;
            let part = |start: usize, length: usize| weights[start..start + length].to_vec();
            let weight = part(layer.weight, input * output);
            let bias = part(layer.bias.expect("every layer has one"), output);
            // The first layer sums up rows of columns that differ from zero; it stands turned.
            let is_turned = layer == self.layers[0];
            let own = |output_: usize| weight.iter().skip(output_).step_by(output).copied();
            let weight = if is_turned { (0..output).flat_map(own).collect() } else { weight };
            DenseLayer { inputs: input, weight, bias }
        })
    }

    /// Numbers of the head.
    pub(super) fn outputs(&self) -> usize {
        self.layers[2].shape.output
    }

    /// Width of the hidden layers.
    pub(super) fn width(&self) -> usize {
        self.layers[1].shape.output
    }

    /// Some numbers of the head by weights `[outputs, width]` of a hidden row.
    pub(super) fn read(
        &self,
        weights: &[f32],
        hidden: &[f32],
        outputs: impl Iterator<Item = usize>,
        to: &mut [f32],
    ) {
        let head = self.layers[2];
        let bias = head.bias.expect("every layer has one");
        for (to, output) in to.iter_mut().zip(outputs) {
            let row = &weights[head.weight + output * hidden.len()..][..hidden.len()];
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
pub(super) struct Space {
    pub(super) tape: Tape,
    pub(super) rows: SparseRows,
    hidden: Vec<f32>,
}

impl Space {
    /// The second hidden layer `[states, width]` for the bytes of states.
    pub(super) fn hidden<'s>(
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
    pub(super) fn hidden_of(
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
pub(super) fn slopes(pass: &mut Pass<'_>, x: Var, slopes: &[f32]) -> Var {
    let columns = pass.size(x)[1];
    let given = pass.input(columns, slopes);
    let product = pass.multiply(x, given);
    let sums = pass.sum_columns(product);
    pass.sum_rows(sums)
}

/// The controller's numbers: a value and advantages of all actions for each goal (Wang et al. 2016).
#[derive(Clone, Copy, Debug)]
pub(super) struct Heads {
    pub(super) goals: usize,
    pub(super) actions: usize,
}

impl Heads {
    pub(super) fn outputs(self) -> usize {
        self.goals * (1 + self.actions)
    }

    /// Values of all actions for one goal, of a hidden row.
    pub(super) fn values(
        self,
        network: &Network,
        weights: &[f32],
        hidden: &[f32],
        goal: usize,
        values: &mut Vec<f32>,
    ) {
        let first = self.goals + goal * self.actions;
        values.clear();
        values.resize(1 + self.actions, 0.0);
        let outputs = std::iter::once(goal).chain(first..first + self.actions);
        network.read(weights, hidden, outputs, values);
        let value = values.remove(0);
        let level = value - values.iter().sum::<f32>() / self.actions as f32;
        values.iter_mut().for_each(|advantage| *advantage += level);
    }

    /// The value of one action, of all numbers of a row.
    pub(super) fn value(self, row: &[f32], goal: usize, action: usize) -> f32 {
        let advantages = &row[self.goals + goal * self.actions..][..self.actions];
        row[goal] + advantages[action] - advantages.iter().sum::<f32>() / self.actions as f32
    }

    /// Adds the slopes of all numbers of a row by that of the value of one action.
    pub(super) fn add_slope(self, slopes: &mut [f32], goal: usize, action: usize, slope: f32) {
        slopes[goal] += slope;
        let advantages = &mut slopes[self.goals + goal * self.actions..][..self.actions];
        advantages.iter_mut().for_each(|advantage| *advantage -= slope / self.actions as f32);
        advantages[action] += slope;
    }
}

/// The first of the largest numbers among those that a mask holds.
pub(super) fn best(values: &[f32], mask: u32) -> usize {
    let open = values.iter().enumerate().filter(|(index, _)| mask >> index & 1 == 1);
    open.reduce(|a, b| if b.1 > a.1 { b } else { a }).map_or(0, |(index, _)| index)
}
