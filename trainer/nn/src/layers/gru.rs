//! The gated recurrent unit as PyTorch has it, through time: many slots with a memory each.
//!
//! `r = s(W_ir x + b_ir + W_hr h + b_hr)`, `z = s(W_iz x + b_iz + W_hz h + b_hz)`,
//! `n = tanh(W_in x + b_in + r (W_hn h + b_hn))`, `h' = (1 - z) n + z h`. Input and memory are equally wide.

use super::linear::{self, LinearShape};
use super::matrix::Store;
use sortie_core::internal::math::{sigmoid, tanh};

/// Sizes of a unit and of what it goes through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GruShape {
    /// Width R of input and memory.
    pub width: usize,
    /// Memories K that go through time side by side.
    pub slots: usize,
}

/// Lengths of the tensors of a unit of a width: `weight_ih [3 R, R]`, `weight_hh [3 R, R]`,
/// `bias_ih [3 R]`, `bias_hh [3 R]`, each in the order r, z, n.
pub const fn lengths(width: usize) -> [usize; 4] {
    [3 * width * width, 3 * width * width, 3 * width, 3 * width]
}

impl GruShape {
    fn gates(self) -> LinearShape {
        LinearShape { input: self.width, output: 3 * self.width }
    }
}

/// The tensors of a vector, in their order.
fn split(width: usize, parameters: &[f32]) -> [&[f32]; 4] {
    let mut rest = parameters;
    lengths(width).map(|length| rest.split_off(..length).expect("all tensors"))
}

/// Buffers of one worker: what the last forward pass needs to be gone through backward.
#[derive(Clone, Debug, Default)]
pub struct GruPass {
    /// `[S, K, 3 R]`, of the input; then the gates r, z, n.
    gates: Vec<f32>,
    /// `[S, K, R]`: the memory's part of n before it is gated.
    candidate: Vec<f32>,
    /// `[S, K, R]`: memories before each step.
    before: Vec<f32>,
    /// `[K, 3 R]`
    of_memory: Vec<f32>,
    d_input_gates: Vec<f32>,
    d_memory_gates: Vec<f32>,
    d_memory: Vec<f32>,
}

impl GruPass {
    /// Writes the memories `[S, K, R]` after each step of `input [S, K, R]`, from `memory [K, R]`, which
    /// becomes what is left after the last step: a memory is emptied behind each step where `carry [S, K]`
    /// says so.
    pub fn forward(
        &mut self,
        shape: GruShape,
        parameters: &[f32],
        (input, carry): (&[f32], &[bool]),
        memory: &mut [f32],
        output: &mut [f32],
    ) {
        let GruShape { width, slots } = shape;
        let [weight_ih, weight_hh, bias_ih, bias_hh] = split(width, parameters);
        let row = slots * width;
        self.gates.resize(3 * input.len(), 0.0);
        self.candidate.resize(input.len(), 0.0);
        self.before.resize(input.len(), 0.0);
        self.of_memory.resize(3 * row, 0.0);
        linear::forward(shape.gates(), input, weight_ih, bias_ih, &mut self.gates);
        for (step, output) in output.chunks_exact_mut(row).enumerate() {
            let place = step * row..(step + 1) * row;
            self.before[place.clone()].copy_from_slice(memory);
            linear::forward(shape.gates(), memory, weight_hh, bias_hh, &mut self.of_memory);
            let gates = self.gates[3 * place.start..3 * place.end].chunks_exact_mut(3 * width);
            let of_memory = self.of_memory.chunks_exact(3 * width);
            let candidates = self.candidate[place].chunks_exact_mut(width);
            let memories = memory.chunks_exact_mut(width).zip(output.chunks_exact_mut(width));
            let carry = &carry[step * slots..];
            for ((((gates, of_memory), candidate), (memory, output)), carry) in
                gates.zip(of_memory).zip(candidates).zip(memories).zip(carry)
            {
                candidate.copy_from_slice(&of_memory[2 * width..]);
                for i in 0..width {
                    let reset = sigmoid(gates[i] + of_memory[i]);
                    let keep = sigmoid(gates[width + i] + of_memory[width + i]);
                    let new = tanh(gates[2 * width + i] + reset * candidate[i]);
                    (gates[i], gates[width + i], gates[2 * width + i]) = (reset, keep, new);
                    output[i] = (1.0 - keep) * new + keep * memory[i];
                    memory[i] = if *carry { output[i] } else { 0.0 };
                }
            }
        }
    }

    /// Adds to `gradient` (all tensors) that of a loss whose slope by the memories after each step is
    /// `d_output [S, K, R]`; writes the slope by the input. The first memories have none.
    pub fn backward(
        &mut self,
        shape: GruShape,
        parameters: &[f32],
        (input, carry): (&[f32], &[bool]),
        (d_output, d_input): (&[f32], &mut [f32]),
        gradient: &mut [f32],
    ) {
        let GruShape { width, slots } = shape;
        let [weight_ih, weight_hh, ..] = split(width, parameters);
        let row = slots * width;
        self.d_input_gates.resize(3 * input.len(), 0.0);
        self.d_memory_gates.resize(3 * input.len(), 0.0);
        let mut d_memory = std::mem::take(&mut self.d_memory);
        d_memory.clear();
        d_memory.resize(row, 0.0);
        for step in (0..d_output.len() / row.max(1)).rev() {
            for slot in 0..slots {
                let index = step * slots + slot;
                let own = index * width..(index + 1) * width;
                let gates = &self.gates[3 * own.start..3 * own.end];
                let d_input_gates = &mut self.d_input_gates[3 * own.start..3 * own.end];
                let d_memory_gates = &mut self.d_memory_gates[3 * own.start..3 * own.end];
                let d_memory = &mut d_memory[slot * width..(slot + 1) * width];
                for i in 0..width {
                    let [reset, keep, new] = [0, 1, 2].map(|gate| gates[gate * width + i]);
                    let behind = if carry[index] { d_memory[i] } else { 0.0 };
                    let slope = d_output[own.start + i] + behind;
                    let d_new = slope * (1.0 - keep) * (1.0 - new * new);
                    let d_keep = slope * (self.before[own.start + i] - new) * keep * (1.0 - keep);
                    let d_reset = d_new * self.candidate[own.start + i] * reset * (1.0 - reset);
                    for (gate, d) in [d_reset, d_keep, d_new].into_iter().enumerate() {
                        d_input_gates[gate * width + i] = d;
                        d_memory_gates[gate * width + i] = d;
                    }
                    d_memory_gates[2 * width + i] *= reset;
                    d_memory[i] = slope * keep;
                }
            }
            let d_gates = &self.d_memory_gates[3 * step * row..3 * (step + 1) * row];
            linear::backward_input(shape.gates(), d_gates, weight_hh, Store::Add, &mut d_memory);
        }
        self.d_memory = d_memory;
        let mut rest = gradient;
        let [d_weight_ih, d_weight_hh, d_bias_ih, d_bias_hh] =
            lengths(width).map(|length| rest.split_off_mut(..length).expect("all tensors"));
        linear::backward_weight(shape.gates(), input, &self.d_input_gates, d_weight_ih);
        linear::backward_bias(&self.d_input_gates, d_bias_ih);
        linear::backward_weight(shape.gates(), &self.before, &self.d_memory_gates, d_weight_hh);
        linear::backward_bias(&self.d_memory_gates, d_bias_hh);
        let d_gates = &self.d_input_gates;
        linear::backward_input(shape.gates(), d_gates, weight_ih, Store::Replace, d_input);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::{assert_gradient, random};

    const SHAPE: GruShape = GruShape { width: 3, slots: 2 };
    const STEPS: usize = 4;

    #[test]
    fn gradients_through_time_agree_with_finite_differences() {
        let input = random(1, STEPS * 6);
        let parameters = random(2, lengths(3).iter().sum());
        let d_output = random(3, STEPS * 6);
        // One memory is emptied behind the second step.
        let carry: Vec<bool> = (0..STEPS * 2).map(|index| index != 3).collect();
        let run = |pass: &mut GruPass, input: &[f32], parameters: &[f32]| {
            let mut output = vec![f32::NAN; STEPS * 6];
            let memory = &mut random(4, 6);
            pass.forward(SHAPE, parameters, (input, &carry), memory, &mut output);
            output.iter().zip(&d_output).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum::<f64>()
        };
        let mut pass = GruPass::default();
        run(&mut pass, &input, &parameters);
        let mut d_input = vec![f32::NAN; input.len()];
        let mut gradient = vec![0.0; parameters.len()];
        let slopes = (&*d_output, &mut *d_input);
        pass.backward(SHAPE, &parameters, (&input, &carry), slopes, &mut gradient);
        let mut other = GruPass::default();
        let mut start = 0;
        for (length, name) in
            lengths(3).into_iter().zip(["weight_ih", "weight_hh", "bias_ih", "bias_hh"])
        {
            let place = start..start + length;
            start = place.end;
            let own = (&parameters[place.clone()], &gradient[place.clone()]);
            let moved = std::cell::RefCell::new((parameters.clone(), GruPass::default()));
            assert_gradient(name, own.0, own.1, |values| {
                let (moved, pass) = &mut *moved.borrow_mut();
                moved[place.clone()].copy_from_slice(values);
                run(pass, &input, moved)
            });
        }
        let other = std::cell::RefCell::new(&mut other);
        assert_gradient("input", &input, &d_input, |input| {
            run(&mut other.borrow_mut(), input, &parameters)
        });
    }
}
