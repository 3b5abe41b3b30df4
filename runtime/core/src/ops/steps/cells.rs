//! What recurrent units do between and behind their products.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, apart, places, slice};
use crate::kernels::Kernels;
use crate::math::{all_finite, sigmoid, tanh};
use crate::policy::{DecideError, Observation};

/// One step of a gated recurrent unit behind its products, gates in the order of ONNX: update z, reset r, candidate n.
///
/// z = σ(x₁ + h₁), r = σ(x₂ + h₂), n = tanh(x₃ + r h₃), and the new state is n + z (h - n).
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct GruCell {
    /// x: W y + b, the three gates of R numbers one behind the other.
    pub input: Place,
    /// U h + c, as long.
    pub recurrent: Place,
    /// The state h, R numbers.
    pub state: Place,
    /// The new state, apart from all others.
    pub to: Place,
}

/// One step of a long short-term memory behind its products, gates in the order of ONNX: input i, output o, forget f,
/// candidate g.
///
/// With a = x + h + b: i = σ(a₁), o = σ(a₂), f = σ(a₃), g = tanh(a₄); the new cell is f c + i g, the new state o tanh of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LstmCell {
    /// Weights: b, four gates of R numbers one behind the other.
    pub bias: u32,
    /// x: W y, as long.
    pub input: Place,
    /// U h, as long.
    pub recurrent: Place,
    /// The cell c, R numbers.
    pub cell: Place,
    /// The new state, apart from all others.
    pub to: Place,
    /// The new cell, apart from all others.
    pub cell_to: Place,
}

/// The gates of a unit, each as many numbers.
#[inline(always)]
fn gates<const GATES: usize>(all: &[f32]) -> [&[f32]; GATES] {
    let mut gates = [&[][..]; GATES];
    let size = all.len() / GATES;
    for (gate, numbers) in gates.iter_mut().zip(all.chunks_exact(size.max(1))) {
        *gate = numbers;
    }
    gates
}

impl Operator for GruCell {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        let Self { input, recurrent, state, to } = self;
        state.len > 0
            && state.len == to.len
            && input.len == recurrent.len
            && u64::from(input.len) == 3 * u64::from(state.len)
            && [input, recurrent, state].iter().all(|read| sizes.hold_apart(&[read, to]))
    }

    fn reads(&self) -> Places {
        Places::of([self.input, self.recurrent, self.state])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (sources, to) = apart(scratch.floats, &self.to)?;
        let (input, recurrent) = (sources.get(&self.input)?, sources.get(&self.recurrent)?);
        let state = sources.get(&self.state)?;
        // The gates saturate: they would turn an overflow into a number.
        if !(all_finite(input) && all_finite(recurrent)) {
            return Err(DecideError::NonFinite);
        }
        let (input, recurrent) = (gates::<3>(input), gates::<3>(recurrent));
        let [x_update, x_reset, x_candidate] = input;
        let [h_update, h_reset, h_candidate] = recurrent;
        // Loops over few slices become vectors, several at a time.
        for ((to, x), h) in to.iter_mut().zip(x_update).zip(h_update) {
            *to = sigmoid(x + h);
        }
        let resets = x_reset.iter().zip(h_reset);
        let candidates = x_candidate.iter().zip(h_candidate);
        for (((to, state), (x_r, h_r)), (x, h)) in
            to.iter_mut().zip(state).zip(resets).zip(candidates)
        {
            let candidate = tanh(x + sigmoid(x_r + h_r) * h);
            *to = candidate + *to * (state - candidate);
        }
        Ok(())
    }
}

impl Operator for LstmCell {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        let Self { input, recurrent, cell, to, cell_to, .. } = self;
        let four = 4 * u64::from(cell.len);
        let reads = [input, recurrent, cell];
        cell.len > 0
            && [to.len, cell_to.len] == [cell.len; 2]
            && input.len == recurrent.len
            && u64::from(input.len) == four
            && sizes.holds_weights(self.bias, four)
            && reads.iter().all(|read| sizes.hold_apart(&[read, to, cell_to]))
    }

    fn reads(&self) -> Places {
        Places::of([self.input, self.recurrent, self.cell])
    }

    fn writes(&self) -> Places {
        Places::of([self.to, self.cell_to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let bias = slice(weights, self.bias, self.input.len as usize)?;
        let wanted = [&self.input, &self.recurrent, &self.cell, &self.to, &self.cell_to];
        let [input, recurrent, cell, to, cell_to] = places(scratch.floats, wanted)?;
        // The gates saturate: they would turn an overflow into a number.
        if !(all_finite(input) && all_finite(recurrent)) {
            return Err(DecideError::NonFinite);
        }
        let (input, recurrent, bias) = (gates::<4>(input), gates::<4>(recurrent), gates::<4>(bias));
        let [x_input, x_output, x_forget, x_candidate] = input;
        let [h_input, h_output, h_forget, h_candidate] = recurrent;
        let [b_input, b_output, b_forget, b_candidate] = bias;
        // Loops over few slices become vectors, several at a time.
        let forget = x_forget.iter().zip(h_forget).zip(b_forget);
        for ((next, cell), ((x, h), b)) in cell_to.iter_mut().zip(&*cell).zip(forget) {
            *next = sigmoid(x + h + b) * cell;
        }
        // What is kept of the result's place until its own turn: the candidates.
        let candidates = x_candidate.iter().zip(h_candidate).zip(b_candidate);
        for (to, ((x, h), b)) in to.iter_mut().zip(candidates) {
            *to = tanh(x + h + b);
        }
        let inputs = x_input.iter().zip(h_input).zip(b_input);
        for ((next, candidate), ((x, h), b)) in cell_to.iter_mut().zip(&*to).zip(inputs) {
            *next += sigmoid(x + h + b) * candidate;
        }
        let outputs = x_output.iter().zip(h_output).zip(b_output);
        for ((to, next), ((x, h), b)) in to.iter_mut().zip(&*cell_to).zip(outputs) {
            *to = sigmoid(x + h + b) * tanh(*next);
        }
        Ok(())
    }
}
