//! Mixers: the value of a team from the utilities of its agents' chosen actions. Used in training only.
//!
//! Each mixes two things: the agents' utilities, and for imagination their 2 A imagined ones. Weights of
//! imagined utilities come from what the hypernetwork sees within and across; all else that a mixer needs
//! comes from everything (dissertation section 5.4.1).

mod hypernetwork;

use sortie_core::internal::math::exp;
use sortie_learn::words;
use sortie_nn::layers::softmax;

use super::looking::Tensor;
use super::scenes::Scenes;
use crate::sized;
use hypernetwork::{HypernetworkPass, HypernetworkShape};

words! {
    /// How the utilities of a team become its value.
    MixerKind {
        /// Their sum (VDN).
        Sum = "sum",
        /// A sum with weights that add up to 1, and a value of the state.
        Linear = "linear",
        /// Two layers with non-negative weights (QMIX).
        Qmix = "qmix",
    }
}

words! {
    /// Who makes the numbers that a mixer mixes with.
    #[derive(Default)]
    Hypernetworks {
        /// One network makes all of them.
        #[default]
        Shared = "shared",
        /// A network for each kind: weights, biases, the value of the state (the dissertation's).
        Separate = "separate",
    }
}

/// Sizes of a mixer and of the hypernetworks that feed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// How it mixes.
    pub kind: MixerKind,
    /// Who makes its numbers.
    pub hypernetworks: Hypernetworks,
    /// Columns of an entity's row.
    pub input: usize,
    /// Columns that are usually not zero.
    pub active_inputs: usize,
    /// Width of a hypernetwork's embedding and attention.
    pub width: usize,
    /// Width between the two layers of QMIX.
    pub mixing: usize,
}

impl MixerShape {
    fn outputs(self) -> usize {
        self.parts().iter().map(|part| part.outputs).sum()
    }

    /// The hypernetworks, whose numbers stand side by side; a sum has none.
    fn parts(self) -> Vec<HypernetworkShape> {
        let kinds: &[(&'static str, usize)] = match self.kind {
            MixerKind::Sum => &[],
            MixerKind::Linear => &LINEAR_KINDS,
            MixerKind::Qmix => &qmix_kinds(self.mixing),
        };
        let Self { input, active_inputs, width, .. } = self;
        let part = |name, outputs, imagines| HypernetworkShape {
            name,
            input,
            active_inputs,
            width,
            outputs,
            imagines,
        };
        match self.hypernetworks {
            Hypernetworks::Shared if kinds.is_empty() => Vec::new(),
            Hypernetworks::Shared => {
                vec![part("", kinds.iter().map(|(_, outputs)| outputs).sum(), true)]
            }
            // What is imagined is weighted by what imagined agents see; nothing else depends on it.
            Hypernetworks::Separate => {
                let kinds = kinds.iter().enumerate();
                kinds.map(|(at, (name, outputs))| part(name, *outputs, at == 0)).collect()
            }
        }
    }

    pub(super) fn tensors(self, mut start: usize) -> Vec<Tensor> {
        let mut tensors = Vec::new();
        for part in self.parts() {
            tensors.extend(part.tensors(start));
            start += part.parameters();
        }
        tensors
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.parts().iter().map(|part| part.parameters()).sum()
    }
}

/// What is mixed.
#[derive(Clone, Copy, Debug)]
pub struct Teams<'a> {
    /// The states of the teams.
    pub scenes: &'a Scenes,
    /// Utilities `[blocks, agents]` of the chosen actions.
    pub utilities: &'a [f32],
}

/// The slopes of a loss by the values of teams.
#[derive(Clone, Copy, Debug)]
pub struct Slopes<'a> {
    /// By the value of each team.
    pub values: &'a [f32],
    /// By the imagined value of each team; empty without imagination.
    pub imagined: &'a [f32],
}

/// One team: its agents among those of all teams, of which each block has a row.
#[derive(Clone, Copy, Debug)]
struct Team {
    first: usize,
    size: usize,
    /// Agents of all teams: rows of a block.
    agents: usize,
}

impl Team {
    /// Rows of the team in a block.
    fn rows(self, block: usize) -> std::ops::Range<usize> {
        let first = block * self.agents + self.first;
        first..first + self.size
    }

    /// Rows of what is mixed: of the first block, or of the imagined ones.
    fn inputs(self, imagined: bool) -> impl Iterator<Item = usize> + Clone {
        let blocks = if imagined { 1..super::split_attention::BLOCKS } else { 0..1 };
        blocks.flat_map(move |block| self.rows(block))
    }
}

/// Activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct MixerPass {
    parts: Vec<HypernetworkPass>,
    numbers: Vec<f32>,
    values: Vec<f32>,
    imagined: Vec<f32>,
    d_numbers: Vec<f32>,
    qmix: Qmix,
}

impl MixerPass {
    /// Computes the value of every team, and with three blocks of utilities the imagined one.
    pub fn forward(
        &mut self,
        shape: MixerShape,
        mut parameters: &[f32],
        teams: Teams<'_>,
        blocks: usize,
    ) -> (&[f32], &[f32]) {
        let Teams { scenes, utilities } = teams;
        let agents = scenes.agents();
        let (parts, outputs) = (shape.parts(), shape.outputs());
        let numbers = sized(&mut self.numbers, blocks * agents * outputs);
        self.parts.resize(parts.len(), HypernetworkPass::default());
        let mut column = 0;
        for (part, pass) in parts.iter().zip(&mut self.parts) {
            let own = parameters.split_off(..part.parameters()).expect("parameters of all parts");
            pass.forward(*part, own, scenes.known(), blocks, (&mut *numbers, outputs, column));
            column += part.outputs;
        }
        self.values.clear();
        self.imagined.clear();
        let mut first = 0;
        for size in scenes.sizes() {
            let team = Team { first, size: *size, agents };
            first += size;
            for imagined in [false, true].into_iter().take(if blocks > 1 { 2 } else { 1 }) {
                let value = match shape.kind {
                    MixerKind::Sum => team.inputs(imagined).map(|row| utilities[row]).sum(),
                    MixerKind::Linear => linear_value(team, numbers, utilities, imagined),
                    MixerKind::Qmix => {
                        self.qmix.value(shape.mixing, team, numbers, utilities, imagined)
                    }
                };
                if imagined { &mut self.imagined } else { &mut self.values }.push(value);
            }
        }
        (&self.values, &self.imagined)
    }

    /// Writes the slope by every utility, and adds to `gradient`, after [`forward`](Self::forward).
    pub fn backward(
        &mut self,
        shape: MixerShape,
        mut parameters: &[f32],
        teams: Teams<'_>,
        slopes: Slopes<'_>,
        d_utilities: &mut [f32],
        mut gradient: &mut [f32],
    ) {
        let Teams { scenes, utilities } = teams;
        let agents = scenes.agents();
        let (parts, outputs) = (shape.parts(), shape.outputs());
        let count = utilities.len() * outputs;
        let numbers = &self.numbers[..count];
        let d_numbers = sized(&mut self.d_numbers, count);
        d_numbers.fill(0.0);
        let mut first = 0;
        for (index, size) in scenes.sizes().iter().enumerate() {
            let team = Team { first, size: *size, agents };
            first += size;
            for (imagined, slopes) in [(false, slopes.values), (true, slopes.imagined)] {
                let Some(slope) = slopes.get(index).copied() else { continue };
                match shape.kind {
                    MixerKind::Sum => {
                        team.inputs(imagined).for_each(|row| d_utilities[row] = slope);
                    }
                    MixerKind::Linear => linear_slopes(
                        team,
                        imagined,
                        slope,
                        (numbers, utilities),
                        (d_numbers, d_utilities),
                    ),
                    MixerKind::Qmix => self.qmix.descend(
                        shape.mixing,
                        (team, imagined, slope),
                        (numbers, utilities),
                        (d_numbers, d_utilities),
                    ),
                }
            }
        }
        let mut column = 0;
        for (part, pass) in parts.iter().zip(&mut self.parts) {
            let own = parameters.split_off(..part.parameters()).expect("parameters of all parts");
            let slopes =
                gradient.split_off_mut(..part.parameters()).expect("gradients of all parts");
            let d_numbers = (&*d_numbers, outputs, column);
            pass.backward(*part, own, scenes.known(), d_numbers, slopes);
            column += part.outputs;
        }
    }
}

/// Numbers for each agent: what its utility is weighted by, and what the state is worth.
const LINEAR_KINDS: [(&str, usize); 2] = [("weights", 1), ("value", 1)];
const LINEAR_OUTPUTS: usize = 2;

/// The largest score of what is mixed, and the sum of `exp(score - largest)`.
fn linear_mass(team: Team, numbers: &[f32], imagined: bool) -> (f32, f32) {
    let scores = team.inputs(imagined).map(|row| numbers[row * LINEAR_OUTPUTS]);
    let largest = scores.clone().fold(f32::NEG_INFINITY, f32::max);
    (largest, scores.map(|score| exp(score - largest)).sum())
}

/// The weight of every row that is mixed.
fn linear_weights(
    team: Team,
    numbers: &[f32],
    imagined: bool,
) -> impl Iterator<Item = (usize, f32)> + Clone {
    let (largest, sum) = linear_mass(team, numbers, imagined);
    team.inputs(imagined).map(move |row| (row, exp(numbers[row * LINEAR_OUTPUTS] - largest) / sum))
}

/// `Q = sum of w_a q_a + V`: `w` is a softmax, over all that is mixed, of the hypernetwork's first number, and `V` the mean
/// of its second over the team.
fn linear_value(team: Team, numbers: &[f32], utilities: &[f32], imagined: bool) -> f32 {
    let mixed: f32 =
        linear_weights(team, numbers, imagined).map(|(row, w)| w * utilities[row]).sum();
    let state: f32 = team.rows(0).map(|row| numbers[row * LINEAR_OUTPUTS + 1]).sum();
    mixed + state / team.size.max(1) as f32
}

fn linear_slopes(
    team: Team,
    imagined: bool,
    slope: f32,
    (numbers, utilities): (&[f32], &[f32]),
    (d_numbers, d_utilities): (&mut [f32], &mut [f32]),
) {
    let weights = linear_weights(team, numbers, imagined);
    let mixed: f32 = weights.clone().map(|(row, w)| w * utilities[row]).sum();
    for (row, weight) in weights {
        d_utilities[row] = slope * weight;
        d_numbers[row * LINEAR_OUTPUTS] += slope * weight * (utilities[row] - mixed);
    }
    let share = slope / team.size.max(1) as f32;
    team.rows(0).for_each(|row| d_numbers[row * LINEAR_OUTPUTS + 1] += share);
}

/// Numbers for each agent, at a mixing width M.
fn qmix_kinds(mixing: usize) -> [(&'static str, usize); 4] {
    [("first", mixing), ("bias", mixing), ("second", mixing), ("value", 1)]
}

fn qmix_outputs(mixing: usize) -> usize {
    3 * mixing + 1
}

/// The mixer of QMIX (dissertation section 5.3.2), with its layers of one team: `Q = w2 . elu(sum of W1[a] q_a + b1) + V`.
///
/// The hypernetwork gives each agent M numbers for its row of `W1`, M for `b1`, M for `w2` and one for `V`; the last three
/// are means over the team. Rows of `W1`, and `w2`, go through a softmax, so that no weight is negative; `b1` and `V` are
/// unrestricted.
#[derive(Clone, Debug, Default)]
struct Qmix {
    /// Rows of `W1`, one behind the other.
    first: Vec<f32>,
    hidden: Vec<f32>,
    second: Vec<f32>,
    d_hidden: Vec<f32>,
    d_second: Vec<f32>,
    d_first: Vec<f32>,
}

impl Qmix {
    fn value(
        &mut self,
        mixing: usize,
        team: Team,
        numbers: &[f32],
        utilities: &[f32],
        imagined: bool,
    ) -> f32 {
        let outputs = qmix_outputs(mixing);
        self.first.clear();
        self.hidden.clear();
        self.hidden.resize(mixing, 0.0);
        self.second.clear();
        self.second.resize(mixing, 0.0);
        for row in team.inputs(imagined) {
            let start = self.first.len();
            self.first.extend_from_slice(&numbers[row * outputs..][..mixing]);
            softmax::forward(&mut self.first[start..]);
            add_scaled(&mut self.hidden, utilities[row], &self.first[start..]);
        }
        let share = 1.0 / team.size.max(1) as f32;
        let mut state = 0.0;
        for row in team.rows(0) {
            let numbers = &numbers[row * outputs..][..outputs];
            add_scaled(&mut self.hidden, share, &numbers[mixing..2 * mixing]);
            add_scaled(&mut self.second, share, &numbers[2 * mixing..3 * mixing]);
            state += share * numbers[3 * mixing];
        }
        self.hidden.iter_mut().for_each(|x| *x = if *x > 0.0 { *x } else { x.exp_m1() });
        softmax::forward(&mut self.second);
        self.second.iter().zip(&self.hidden).map(|(w, x)| w * x).sum::<f32>() + state
    }

    fn descend(
        &mut self,
        mixing: usize,
        (team, imagined, slope): (Team, bool, f32),
        (numbers, utilities): (&[f32], &[f32]),
        (d_numbers, d_utilities): (&mut [f32], &mut [f32]),
    ) {
        self.value(mixing, team, numbers, utilities, imagined);
        let outputs = qmix_outputs(mixing);
        self.d_second.clear();
        self.d_second.extend(self.hidden.iter().map(|x| slope * x));
        softmax::backward(&self.second, &mut self.d_second);
        self.d_hidden.clear();
        let layers = self.second.iter().zip(&self.hidden);
        self.d_hidden.extend(layers.map(|(w, x)| slope * w * if *x > 0.0 { 1.0 } else { x + 1.0 }));
        for (row, first) in team.inputs(imagined).zip(self.first.chunks_exact(mixing)) {
            d_utilities[row] = first.iter().zip(&self.d_hidden).map(|(w, d)| w * d).sum();
            self.d_first.clear();
            self.d_first.extend(self.d_hidden.iter().map(|d| utilities[row] * d));
            softmax::backward(first, &mut self.d_first);
            add_scaled(&mut d_numbers[row * outputs..][..mixing], 1.0, &self.d_first);
        }
        let share = 1.0 / team.size.max(1) as f32;
        for row in team.rows(0) {
            let d_numbers = &mut d_numbers[row * outputs..][..outputs];
            add_scaled(&mut d_numbers[mixing..2 * mixing], share, &self.d_hidden);
            add_scaled(&mut d_numbers[2 * mixing..3 * mixing], share, &self.d_second);
            d_numbers[3 * mixing] += share * slope;
        }
    }
}

fn add_scaled(out: &mut [f32], factor: f32, values: &[f32]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += factor * value;
    }
}
