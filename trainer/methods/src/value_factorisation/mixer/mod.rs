//! Mixers: the value of a team from the utilities of its agents' chosen actions. Used in training only.
//!
//! Each mixes two things: the agents' utilities, and for imagination their 2 A imagined ones. Weights of
//! imagined utilities come from what the hypernetwork sees within and across; all else that a mixer needs
//! comes from everything (dissertation section 5.4.1).

mod hypernetwork;
mod linear;
mod qmix;
mod sum;

use serde::{Deserialize, Serialize};

use self::hypernetwork::{HypernetworkPass, HypernetworkShape};
use super::buffers::sized;
use super::scenes::Scenes;
use super::tensors::Tensor;

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

/// Who makes the numbers that a mixer mixes with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Hypernetworks {
    /// One network makes all of them.
    #[default]
    Shared,
    /// A network for each kind: weights, biases, the value of the state (the dissertation's).
    Separate,
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
    /// Numbers for each agent.
    fn outputs(self) -> usize {
        self.parts().iter().map(|part| part.outputs).sum()
    }

    /// The hypernetworks, whose numbers stand side by side; a sum has none.
    fn parts(self) -> Vec<HypernetworkShape> {
        let kinds: &[(&'static str, usize)] = match self.kind {
            MixerKind::Sum => &[],
            MixerKind::Linear => &linear::KINDS,
            MixerKind::Qmix => &qmix::kinds(self.mixing),
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

    /// The tensors.
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
    scratch: qmix::Scratch,
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
