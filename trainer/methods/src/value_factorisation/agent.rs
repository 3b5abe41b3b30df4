//! The agents' network, shared by all of them: entities are embedded and looked at, a head says what each
//! action is worth (dissertation section 5.4, feed-forward).
//!
//! `h = relu(W_o o + b_o + W_s x)`, `q = head h`, with `o` what the agent attends to and `x` its own
//! embedding. The published network has no `W_s`: it sees its own row through attention only.

use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::relu;

use super::buffers::sized;
use super::looking::{Gradients, Looking, Weights};
use super::scenes::Scenes;
use super::tensors::{Tensor, place, views, views_mut};

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
}

impl AgentShape {
    /// The tensors, `fc1.weight [D, E]`, all other matrices `[out, in]`.
    pub(super) fn tensors(self, start: usize) -> Vec<Tensor> {
        let Self { active_inputs, width, .. } = self;
        let numbers = self.numbers();
        let inputs = [active_inputs, active_inputs, width, width, width, width, width, width];
        let names = [
            "fc1.weight",
            "fc1.bias",
            "attention.in.weight",
            "attention.out.weight",
            "attention.out.bias",
            "skip.weight",
            "head.weight",
            "head.bias",
        ];
        let all = (0..names.len()).map(|index| (names[index], inputs[index], numbers[index]));
        place(start, "agent", &all.filter(|(_, _, numbers)| *numbers > 0).collect::<Vec<_>>())
    }

    fn numbers(self) -> [usize; 8] {
        let Self { input, width, actions, skip, .. } = self;
        let square = width * width;
        [
            input * width,
            width,
            3 * square,
            square,
            width,
            if skip { square } else { 0 },
            actions * width,
            actions,
        ]
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.numbers().into_iter().sum()
    }

    /// The tensors in a vector of parameters.
    pub(super) fn views(self, parameters: &[f32]) -> [&[f32]; 8] {
        views(parameters, self.numbers())
    }

    fn square(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    fn head(self) -> LinearShape {
        LinearShape { input: self.width, output: self.actions }
    }
}

/// Activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub struct AgentPass {
    looking: Looking,
    own: Vec<f32>,
    hidden: Vec<f32>,
    utilities: Vec<f32>,
    d_hidden: Vec<f32>,
    d_own: Vec<f32>,
    d_past: Vec<f32>,
    d_attended: Vec<f32>,
}

impl AgentPass {
    /// Computes the utilities `[blocks, agents, U]`: of what is seen and, with three blocks, of what is
    /// imagined within and across.
    pub fn forward(
        &mut self,
        shape: AgentShape,
        parameters: &[f32],
        scenes: &Scenes,
        blocks: usize,
    ) -> &[f32] {
        let [fc1, fc1_bias, attention_in, out, out_bias, skip, head, head_bias] =
            shape.views(parameters);
        let weights = Weights { fc1, fc1_bias, attention_in };
        let numbers = scenes.agents() * shape.width;
        let attended =
            self.looking.forward(shape.width, weights, scenes.rows(), scenes.seen(), blocks);
        let hidden = sized(&mut self.hidden, blocks * numbers);
        linear::forward(shape.square(), attended, out, out_bias, hidden);
        if shape.skip {
            let own = sized(&mut self.own, numbers);
            linear::forward_without_bias(shape.square(), self.looking.own(numbers), skip, own);
            for block in hidden.chunks_exact_mut(numbers.max(1)) {
                add(block, own);
            }
        }
        relu::forward(hidden);
        let utilities = sized(&mut self.utilities, blocks * scenes.agents() * shape.actions);
        linear::forward(shape.head(), hidden, head, head_bias, utilities);
        utilities
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
        let [fc1, fc1_bias, attention_in, out, _, skip, head, _] = shape.views(parameters);
        let [d_fc1, d_fc1_bias, d_attention_in, d_out, d_out_bias, d_skip, d_head, d_head_bias] =
            views_mut(gradient, shape.numbers());
        let numbers = scenes.agents() * shape.width;
        let all = d_utilities.len() / shape.actions * shape.width;
        let hidden = &self.hidden[..all];
        let d_hidden = sized(&mut self.d_hidden, all);
        linear::backward_weight(shape.head(), hidden, d_utilities, d_head);
        linear::backward_bias(d_utilities, d_head_bias);
        linear::backward_input(shape.head(), d_utilities, head, Store::Replace, d_hidden);
        relu::backward(hidden, d_hidden);

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
            let own = self.looking.own(numbers);
            linear::backward_weight(shape.square(), own, d_own, d_skip);
            let past = sized(&mut self.d_past, numbers);
            linear::backward_input(shape.square(), d_own, skip, Store::Replace, past);
            d_past = Some(&*past);
        }
        let gradients =
            Gradients { fc1: d_fc1, fc1_bias: d_fc1_bias, attention_in: d_attention_in };
        let weights = Weights { fc1, fc1_bias, attention_in };
        let looked = (scenes.rows(), scenes.seen());
        self.looking.backward(shape.width, weights, looked, d_attended, d_past, gradients);
    }
}

fn add(to: &mut [f32], values: &[f32]) {
    to.iter_mut().zip(values).for_each(|(to, value)| *to += value);
}
