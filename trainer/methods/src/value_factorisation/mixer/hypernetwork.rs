//! A network that looks at all entities and makes numbers for each agent: what a mixer mixes with.

use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;

use crate::sized;
use crate::value_factorisation::looking::{
    Gradients, Looking, Tensor, View, Weights, place, views, views_mut,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct HypernetworkShape {
    /// What its numbers are for; empty where it is the only one.
    pub(super) name: &'static str,
    pub(super) input: usize,
    /// Columns that are usually not zero.
    pub(super) active_inputs: usize,
    pub(super) width: usize,
    pub(super) outputs: usize,
    /// Whether imagined agents have numbers of their own.
    pub(super) imagines: bool,
}

impl HypernetworkShape {
    fn numbers(self) -> [usize; 5] {
        let Self { input, width, outputs, .. } = self;
        [input * width, width, 3 * width * width, outputs * width, outputs]
    }

    /// The tensors. No activation stands between the attention's output and the layer behind it, so that
    /// both are one matrix, `project`.
    pub(super) fn tensors(self, start: usize) -> Vec<Tensor> {
        let Self { active_inputs, width, .. } = self;
        let names =
            ["fc1.weight", "fc1.bias", "attention.in.weight", "project.weight", "project.bias"];
        let inputs = [active_inputs, active_inputs, width, width, width];
        let numbers = self.numbers();
        let all: Vec<_> =
            (0..names.len()).map(|index| (names[index], inputs[index], numbers[index])).collect();
        let prefix = if self.name.is_empty() { "" } else { "." };
        place(start, &format!("mixer{prefix}{}", self.name), &all)
    }

    pub(super) fn parameters(self) -> usize {
        self.numbers().into_iter().sum()
    }

    fn project(self) -> LinearShape {
        LinearShape { input: self.width, output: self.outputs }
    }
}

/// Activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct HypernetworkPass {
    looking: Looking,
    numbers: Vec<f32>,
    d_attended: Vec<f32>,
}

impl HypernetworkPass {
    /// Writes the numbers of every agent, in so many blocks, from a column of rows that are so wide.
    pub(super) fn forward(
        &mut self,
        shape: HypernetworkShape,
        parameters: &[f32],
        view: View<'_>,
        blocks: usize,
        (out, stride, column): (&mut [f32], usize, usize),
    ) {
        let [fc1, fc1_bias, attention_in, project, bias] = views(parameters, shape.numbers());
        let weights = Weights { fc1, fc1_bias, attention_in };
        let blocks = if shape.imagines { blocks } else { 1 };
        let numbers = sized(&mut self.numbers, blocks * view.lists.queries() * shape.outputs);
        let attended = self.looking.forward(shape.width, weights, view, blocks);
        linear::forward(shape.project(), attended, project, bias, numbers);
        let rows = out.chunks_exact_mut(stride).zip(numbers.chunks_exact(shape.outputs));
        rows.for_each(|(out, own)| out[column..column + shape.outputs].copy_from_slice(own));
    }

    /// Adds to `gradient`, after [`forward`](Self::forward), that of a loss with these slopes, which stand
    /// where the numbers stood.
    pub(super) fn backward(
        &mut self,
        shape: HypernetworkShape,
        parameters: &[f32],
        view: View<'_>,
        (d_out, stride, column): (&[f32], usize, usize),
        gradient: &mut [f32],
    ) {
        let [fc1, fc1_bias, attention_in, project, _] = views(parameters, shape.numbers());
        let [d_fc1, d_fc1_bias, d_attention_in, d_project, d_bias] =
            views_mut(gradient, shape.numbers());
        let all = d_out.len() / stride;
        let rows = if shape.imagines { all } else { view.lists.queries() };
        // What follows needs the slopes alone, so that they take the place of the numbers.
        let d_numbers = sized(&mut self.numbers, rows * shape.outputs);
        let own = d_numbers.chunks_exact_mut(shape.outputs).zip(d_out.chunks_exact(stride));
        own.for_each(|(own, all)| own.copy_from_slice(&all[column..column + shape.outputs]));
        let attended = self.looking.attended(rows * shape.width);
        linear::backward_weight(shape.project(), attended, d_numbers, d_project);
        linear::backward_bias(d_numbers, d_bias);
        let d_attended = sized(&mut self.d_attended, rows * shape.width);
        linear::backward_input(shape.project(), d_numbers, project, Store::Replace, d_attended);
        let gradients =
            Gradients { fc1: d_fc1, fc1_bias: d_fc1_bias, attention_in: d_attention_in };
        let weights = Weights { fc1, fc1_bias, attention_in };
        self.looking.backward(shape.width, weights, view, d_attended, None, gradients);
    }
}
