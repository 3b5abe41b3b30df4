//! What agents remember: a gated recurrent unit through the steps of their episodes.
//!
//! An agent's memory is empty before its episode and wherever the agent is absent. Each block of
//! imagination has memories of its own.

use sortie_nn::layers::gru::{GruPass, GruShape, lengths};

use crate::sized;

/// When a state was, in which of the episodes that go through time side by side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moment {
    /// Steps since the episode began.
    pub step: usize,
    /// Number of the episode.
    pub episode: usize,
}

/// Where the rows of agents stand in time and among episodes.
#[derive(Clone, Debug, Default)]
pub(super) struct Timeline {
    steps: usize,
    episodes: usize,
    /// Agents of an episode, absent ones too.
    agents: usize,
    /// Step and slot of each row.
    rows: Vec<(usize, usize)>,
}

impl Timeline {
    pub(super) fn clear(&mut self) {
        (self.steps, self.episodes) = (0, 0);
        self.rows.clear();
    }

    /// Adds a state of some agents, of which these are present.
    pub(super) fn push(
        &mut self,
        moment: Moment,
        agents: usize,
        present: impl Iterator<Item = usize>,
    ) {
        self.steps = self.steps.max(moment.step + 1);
        self.episodes = self.episodes.max(moment.episode + 1);
        self.agents = agents;
        self.rows.extend(present.map(|agent| (moment.step, moment.episode * agents + agent)));
    }

    /// Memories that go through time side by side, `[episodes, A]`.
    pub(super) fn slots(&self) -> usize {
        self.episodes * self.agents
    }

    /// Where each row stands among `[steps, blocks, slots]`, block by block.
    fn places(&self, blocks: usize) -> impl Iterator<Item = usize> {
        let slots = self.slots();
        (0..blocks).flat_map(move |block| {
            let rows = self.rows.iter();
            rows.map(move |(step, slot)| (step * blocks + block) * slots + slot)
        })
    }
}

/// Names and lengths of a unit's tensors.
pub(super) fn tensors(width: usize) -> [(&'static str, usize); 4] {
    let [input, memory, input_bias, memory_bias] = lengths(width);
    [
        ("memory.input.weight", input),
        ("memory.recurrent.weight", memory),
        ("memory.input.bias", input_bias),
        ("memory.recurrent.bias", memory_bias),
    ]
}

/// Activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct MemoryPass {
    gru: GruPass,
    /// `[steps, blocks, slots]`: who is there to remember.
    carry: Vec<bool>,
    /// `[steps, blocks, slots, R]`
    inputs: Vec<f32>,
    outputs: Vec<f32>,
    d_inputs: Vec<f32>,
    d_outputs: Vec<f32>,
    /// `[blocks, slots, R]`
    memory: Vec<f32>,
}

impl MemoryPass {
    /// Replaces rows `[blocks, rows, R]` by what agents remember behind each step. `memory [slots, R]` is what
    /// they remember before the first, of every block, and becomes what those of the first block remember
    /// behind the last; none: nothing.
    pub(super) fn forward(
        &mut self,
        width: usize,
        unit: &[f32],
        (timeline, blocks): (&Timeline, usize),
        memory: Option<&mut [f32]>,
        rows: &mut [f32],
    ) {
        let shape = GruShape { width, slots: blocks * timeline.slots() };
        let all = timeline.steps * shape.slots;
        self.carry.clear();
        self.carry.resize(all, false);
        self.inputs.clear();
        self.inputs.resize(all * width, 0.0);
        for (place, row) in timeline.places(blocks).zip(rows.chunks_exact(width)) {
            self.carry[place] = true;
            self.inputs[place * width..][..width].copy_from_slice(row);
        }
        self.memory.clear();
        for _ in 0..blocks {
            match &memory {
                Some(memory) => self.memory.extend_from_slice(memory),
                None => self.memory.resize(self.memory.len() + timeline.slots() * width, 0.0),
            }
        }
        self.outputs.resize(self.inputs.len(), 0.0);
        let input = (&*self.inputs, &*self.carry);
        self.gru.forward(shape, unit, input, &mut self.memory, &mut self.outputs);
        for (place, row) in timeline.places(blocks).zip(rows.chunks_exact_mut(width)) {
            row.copy_from_slice(&self.outputs[place * width..][..width]);
        }
        if let Some(memory) = memory {
            memory.copy_from_slice(&self.memory[..memory.len()]);
        }
    }

    /// Replaces slopes `[blocks, rows, R]` by what agents remember behind each step by those by the rows, and
    /// adds to `gradient`.
    pub(super) fn backward(
        &mut self,
        width: usize,
        unit: &[f32],
        (timeline, blocks): (&Timeline, usize),
        d_rows: &mut [f32],
        gradient: &mut [f32],
    ) {
        let shape = GruShape { width, slots: blocks * timeline.slots() };
        self.d_outputs.clear();
        self.d_outputs.resize(self.inputs.len(), 0.0);
        for (place, row) in timeline.places(blocks).zip(d_rows.chunks_exact(width)) {
            self.d_outputs[place * width..][..width].copy_from_slice(row);
        }
        let d_inputs = sized(&mut self.d_inputs, self.inputs.len());
        let input = (&*self.inputs, &*self.carry);
        self.gru.backward(shape, unit, input, (&self.d_outputs, &mut *d_inputs), gradient);
        for (place, row) in timeline.places(blocks).zip(d_rows.chunks_exact_mut(width)) {
            row.copy_from_slice(&d_inputs[place * width..][..width]);
        }
    }
}
