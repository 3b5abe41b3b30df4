//! Mixers: the value of a team from the utilities of its agents' chosen actions. Used in training only.
//!
//! Each mixes two things: the agents' utilities, and for imagination their 2 A imagined ones. Weights of
//! imagined utilities come from what the hypernetwork sees within and across; all else that a mixer needs
//! comes from everything (dissertation section 5.4.1).

mod linear;
mod qmix;
mod sum;

use serde::{Deserialize, Serialize};
use sortie_nn::layers::linear::{self as dense, LinearShape};
use sortie_nn::layers::matrix::Store;

use super::buffers::sized;
use super::looking::{Gradients, Looking, Weights};
use super::scenes::Scenes;
use super::tensors::{Tensor, place, views, views_mut};

/// How the utilities of a team become its value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MixerKind {
    /// Their sum (VDN).
    Sum,
    /// A sum with weights that add up to 1, and a value of the state.
    #[default]
    Linear,
    /// Two layers with non-negative weights (QMIX).
    Qmix,
}

/// Sizes of a mixer and of the hypernetwork that feeds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixerShape {
    /// How it mixes.
    pub kind: MixerKind,
    /// Columns of an entity's row.
    pub input: usize,
    /// Columns that are usually not zero.
    pub active_inputs: usize,
    /// Width of the hypernetwork's embedding and attention.
    pub width: usize,
    /// Width between the two layers of QMIX.
    pub mixing: usize,
}

impl MixerShape {
    /// Numbers of the hypernetwork for each agent.
    fn outputs(self) -> usize {
        match self.kind {
            MixerKind::Sum => 0,
            MixerKind::Linear => linear::OUTPUTS,
            MixerKind::Qmix => qmix::outputs(self.mixing),
        }
    }

    fn numbers(self) -> [usize; 5] {
        let Self { input, width, .. } = self;
        match self.kind {
            MixerKind::Sum => [0; 5],
            _ => {
                let outputs = self.outputs();
                [input * width, width, 3 * width * width, outputs * width, outputs]
            }
        }
    }

    /// The tensors; a sum has none. No activation stands between the attention's output and the layer
    /// behind it, so that both are one matrix, `project`.
    pub(super) fn tensors(self, start: usize) -> Vec<Tensor> {
        let Self { active_inputs, width, .. } = self;
        let names =
            ["fc1.weight", "fc1.bias", "attention.in.weight", "project.weight", "project.bias"];
        let inputs = [active_inputs, active_inputs, width, width, width];
        let numbers = self.numbers();
        let all = (0..names.len()).map(|index| (names[index], inputs[index], numbers[index]));
        place(start, "mixer", &all.filter(|(_, _, numbers)| *numbers > 0).collect::<Vec<_>>())
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.numbers().into_iter().sum()
    }

    fn project(self) -> LinearShape {
        LinearShape { input: self.width, output: self.outputs() }
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
    looking: Looking,
    numbers: Vec<f32>,
    values: Vec<f32>,
    imagined: Vec<f32>,
    d_numbers: Vec<f32>,
    d_attended: Vec<f32>,
    scratch: qmix::Scratch,
}

impl MixerPass {
    /// Computes the value of every team, and with three blocks of utilities the imagined one.
    pub fn forward(
        &mut self,
        shape: MixerShape,
        parameters: &[f32],
        teams: Teams<'_>,
        blocks: usize,
    ) -> (&[f32], &[f32]) {
        let Teams { scenes, utilities } = teams;
        let agents = scenes.agents();
        let outputs = shape.outputs();
        let numbers = sized(&mut self.numbers, blocks * agents * outputs);
        if outputs > 0 {
            let [fc1, fc1_bias, attention_in, project, bias] = views(parameters, shape.numbers());
            let weights = Weights { fc1, fc1_bias, attention_in };
            let (rows, known) = (scenes.rows(), scenes.known());
            let attended = self.looking.forward(shape.width, weights, rows, known, blocks);
            dense::forward(shape.project(), attended, project, bias, numbers);
        }
        self.values.clear();
        self.imagined.clear();
        let mut first = 0;
        for size in scenes.sizes() {
            let team = Team { first, size: *size, agents };
            first += size;
            for imagined in [false, true].into_iter().take(if blocks > 1 { 2 } else { 1 }) {
                let value = match shape.kind {
                    MixerKind::Sum => sum::value(team, utilities, imagined),
                    MixerKind::Linear => linear::value(team, numbers, utilities, imagined),
                    MixerKind::Qmix => {
                        self.scratch.value(shape.mixing, team, numbers, utilities, imagined)
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
        parameters: &[f32],
        teams: Teams<'_>,
        slopes: Slopes<'_>,
        d_utilities: &mut [f32],
        gradient: &mut [f32],
    ) {
        let Teams { scenes, utilities } = teams;
        let agents = scenes.agents();
        let outputs = shape.outputs();
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
                    MixerKind::Sum => sum::descend(team, imagined, slope, d_utilities),
                    MixerKind::Linear => linear::descend(
                        team,
                        imagined,
                        slope,
                        (numbers, utilities),
                        (d_numbers, d_utilities),
                    ),
                    MixerKind::Qmix => self.scratch.descend(
                        shape.mixing,
                        (team, imagined, slope),
                        (numbers, utilities),
                        (d_numbers, d_utilities),
                    ),
                }
            }
        }
        if outputs == 0 {
            return;
        }
        let [fc1, fc1_bias, attention_in, project, _] = views(parameters, shape.numbers());
        let [d_fc1, d_fc1_bias, d_attention_in, d_project, d_bias] =
            views_mut(gradient, shape.numbers());
        let wide = utilities.len() * shape.width;
        dense::backward_weight(shape.project(), self.looking.attended(wide), d_numbers, d_project);
        dense::backward_bias(d_numbers, d_bias);
        let d_attended = sized(&mut self.d_attended, wide);
        dense::backward_input(shape.project(), d_numbers, project, Store::Replace, d_attended);
        let gradients =
            Gradients { fc1: d_fc1, fc1_bias: d_fc1_bias, attention_in: d_attention_in };
        let weights = Weights { fc1, fc1_bias, attention_in };
        let looked = (scenes.rows(), scenes.known());
        self.looking.backward(shape.width, weights, looked, d_attended, None, gradients);
    }
}
