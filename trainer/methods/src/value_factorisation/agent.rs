//! The agents' network, shared by all of them: entities are embedded and looked at, a head says what each
//! action is worth (dissertation section 5.4).
//!
//! Without memory `q = head relu(a)`, `a = W_o o + b_o + W_s x`, with `o` what the agent attends to and `x` its
//! own embedding; with memory `q = head h`, `h = GRU(relu(fc2 a), h before)`. The published networks have no
//! `W_s`: they see their own row through attention only.

use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::relu;

use super::looking::{Gradients, Looking, Tensor, Weights, place, views, views_mut};
use super::memory::{self, MemoryPass};
use super::scenes::Scenes;
use crate::sized;

/// Sizes of the agents' network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AgentShape {
    /// Columns of an entity's row.
    pub input: usize,
    /// Columns that are usually not zero, by which the first weights of `fc1` are scaled.
    pub active_inputs: usize,
    /// Width of embedding and attention, one of those that attention is built for.
    pub width: usize,
    /// Actions.
    pub actions: usize,
    /// Whether the agent's own embedding reaches the layer before the head.
    pub skip: bool,
    /// Width of what agents remember; 0: they remember nothing.
    pub memory: usize,
}

impl AgentShape {
    /// The tensors, `fc1.weight [D, E]`, all other matrices `[out, in]`.
    pub(super) fn tensors(self, start: usize) -> Vec<Tensor> {
        let Self { active_inputs, width, .. } = self;
        let [fc1, fc1_bias, attention_in, out, out_bias, skip, fc2, fc2_bias, _, head, head_bias] =
            self.numbers();
        let mut all = vec![
            ("fc1.weight", active_inputs, fc1),
            ("fc1.bias", active_inputs, fc1_bias),
            ("attention.in.weight", width, attention_in),
            ("attention.out.weight", width, out),
            ("attention.out.bias", width, out_bias),
            ("skip.weight", width, skip),
            ("fc2.weight", width, fc2),
            ("fc2.bias", width, fc2_bias),
        ];
        let unit = memory::tensors(self.memory);
        all.extend(unit.map(|(name, numbers)| (name, self.memory, numbers)));
        all.push(("head.weight", self.last(), head));
        all.push(("head.bias", self.last(), head_bias));
        all.retain(|(_, _, numbers)| *numbers > 0);
        place(start, "agent", &all)
    }

    fn numbers(self) -> [usize; 11] {
        let Self { input, width, actions, skip, memory, .. } = self;
        let square = width * width;
        [
            input * width,
            width,
            3 * square,
            square,
            width,
            if skip { square } else { 0 },
            memory * width,
            memory,
            memory::tensors(memory).iter().map(|(_, numbers)| numbers).sum(),
            actions * self.last(),
            actions,
        ]
    }

    /// Width before the head.
    pub(super) fn last(self) -> usize {
        if self.memory > 0 { self.memory } else { self.width }
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.numbers().into_iter().sum()
    }

    /// The tensors in a vector of parameters.
    pub(super) fn views(self, parameters: &[f32]) -> [&[f32]; 11] {
        views(parameters, self.numbers())
    }

    fn square(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    fn second(self) -> LinearShape {
        LinearShape { input: self.width, output: self.memory }
    }

    fn head(self) -> LinearShape {
        LinearShape { input: self.last(), output: self.actions }
    }
}

/// Activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct AgentPass {
    looking: Looking,
    own: Vec<f32>,
    hidden: Vec<f32>,
    base: Vec<f32>,
    memory: MemoryPass,
    remembered: Vec<f32>,
    utilities: Vec<f32>,
    d_last: Vec<f32>,
    d_hidden: Vec<f32>,
    d_own: Vec<f32>,
    d_past: Vec<f32>,
    d_attended: Vec<f32>,
}

impl AgentPass {
    /// Computes the utilities `[blocks, agents, U]`: of what is seen and, with three blocks, of what is
    /// imagined within and across. Who remembers begins with nothing.
    pub fn forward(
        &mut self,
        shape: AgentShape,
        parameters: &[f32],
        scenes: &Scenes,
        blocks: usize,
    ) -> &[f32] {
        self.forward_from(shape, parameters, (scenes, blocks), None)
    }

    /// As [`forward`](Self::forward), of agents that remember this: `[episodes, A, memory]`, which becomes what
    /// they remember then.
    pub fn forward_from(
        &mut self,
        shape: AgentShape,
        parameters: &[f32],
        (scenes, blocks): (&Scenes, usize),
        memory: Option<&mut [f32]>,
    ) -> &[f32] {
        let [
            fc1,
            fc1_bias,
            attention_in,
            out,
            out_bias,
            skip,
            fc2,
            fc2_bias,
            unit,
            head,
            head_bias,
        ] = shape.views(parameters);
        let weights = Weights { fc1, fc1_bias, attention_in };
        let numbers = scenes.agents() * shape.width;
        let attended = self.looking.forward(shape.width, weights, scenes.seen(), blocks);
        let hidden = sized(&mut self.hidden, blocks * numbers);
        linear::forward(shape.square(), attended, out, out_bias, hidden);
        if shape.skip {
            let own = sized(&mut self.own, numbers);
            let embedding = self.looking.own(shape.width, scenes.seen());
            linear::forward_without_bias(shape.square(), embedding, skip, own);
            for block in hidden.chunks_exact_mut(numbers.max(1)) {
                add(block, own);
            }
        }
        let mut last = hidden;
        if shape.memory > 0 {
            let base = sized(&mut self.base, blocks * scenes.agents() * shape.memory);
            linear::forward_rectified(shape.second(), last, fc2, fc2_bias, base);
            let remembered = sized(&mut self.remembered, base.len());
            remembered.copy_from_slice(base);
            let time = (scenes.timeline(), blocks);
            self.memory.forward(shape.memory, unit, time, memory, remembered);
            last = remembered;
        } else {
            relu::forward(last);
        }
        let utilities = sized(&mut self.utilities, blocks * scenes.agents() * shape.actions);
        linear::forward(shape.head(), last, head, head_bias, utilities);
        utilities
    }

    /// The first utilities of the last forward pass, of so many agents.
    pub(super) fn utilities(&self, shape: AgentShape, agents: usize) -> &[f32] {
        &self.utilities[..agents * shape.actions]
    }

    /// Adds to `gradient` that of a loss whose slope by the utilities of the last forward pass is
    /// `d_utilities`, which has as many blocks.
    pub fn backward(
        &mut self,
        shape: AgentShape,
        parameters: &[f32],
        scenes: &Scenes,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) {
        let [fc1, fc1_bias, attention_in, out, _, skip, fc2, _, unit, head, _] =
            shape.views(parameters);
        let [
            d_fc1,
            d_fc1_bias,
            d_attention_in,
            d_out,
            d_out_bias,
            d_skip,
            d_fc2,
            d_fc2_bias,
            d_unit,
            d_head,
            d_head_bias,
        ] = views_mut(gradient, shape.numbers());
        let numbers = scenes.agents() * shape.width;
        let rows = d_utilities.len() / shape.actions;
        let all = rows * shape.width;
        let hidden = &self.hidden[..all];
        let last = if shape.memory > 0 { &self.remembered } else { hidden };
        let last = &last[..rows * shape.last()];
        let mut d_hidden = sized(&mut self.d_last, last.len());
        linear::backward_weight(shape.head(), last, d_utilities, d_head);
        linear::backward_bias(d_utilities, d_head_bias);
        linear::backward_input(shape.head(), d_utilities, head, Store::Replace, d_hidden);
        if shape.memory > 0 {
            let time = (scenes.timeline(), rows / scenes.agents().max(1));
            self.memory.backward(shape.memory, unit, time, d_hidden, d_unit);
            relu::backward(&self.base[..d_hidden.len()], d_hidden);
            let d_base = d_hidden;
            linear::backward_weight(shape.second(), hidden, d_base, d_fc2);
            linear::backward_bias(d_base, d_fc2_bias);
            d_hidden = sized(&mut self.d_hidden, all);
            linear::backward_input(shape.second(), d_base, fc2, Store::Replace, d_hidden);
        } else {
            relu::backward(hidden, d_hidden);
        }

        let attended = self.looking.attended(all);
        linear::backward_weight(shape.square(), attended, d_hidden, d_out);
        linear::backward_bias(d_hidden, d_out_bias);
        let d_attended = sized(&mut self.d_attended, all);
        linear::backward_input(shape.square(), d_hidden, out, Store::Replace, d_attended);
        let mut d_past = None;
        if shape.skip {
            let d_own = sized(&mut self.d_own, numbers);
            d_own.copy_from_slice(&d_hidden[..numbers]);
            for block in d_hidden.chunks_exact(numbers.max(1)).skip(1) {
                add(d_own, block);
            }
            let own = self.looking.own(shape.width, scenes.seen());
            linear::backward_weight(shape.square(), own, d_own, d_skip);
            let past = sized(&mut self.d_past, numbers);
            linear::backward_input(shape.square(), d_own, skip, Store::Replace, past);
            d_past = Some(&*past);
        }
        let gradients =
            Gradients { fc1: d_fc1, fc1_bias: d_fc1_bias, attention_in: d_attention_in };
        let weights = Weights { fc1, fc1_bias, attention_in };
        let view = scenes.seen();
        self.looking.backward(shape.width, weights, view, d_attended, d_past, gradients);
    }
}

fn add(to: &mut [f32], values: &[f32]) {
    to.iter_mut().zip(values).for_each(|(to, value)| *to += value);
}
