//! What recurrent units do between and behind their products.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, apart, places, slice};
use crate::kernels::Kernels;
use crate::math::{all_finite, sigmoid, tanh};
use crate::policy::{DecideError, Observation};

/// Numbers that are worked on together: their gates fit into registers.
const LANES: usize = 16;

type Lanes = [f32; LANES];

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

/// Some numbers of every gate, zeros behind the last.
#[inline(always)]
fn lanes<const GATES: usize>(gates: [&[f32]; GATES], first: usize) -> [Lanes; GATES] {
    gates.map(|gate| {
        let gate = gate.get(first..).unwrap_or_default();
        match gate.first_chunk() {
            Some(lanes) => *lanes,
            None => {
                let mut lanes = [0.0; LANES];
                for (lane, number) in lanes.iter_mut().zip(gate) {
                    *lane = *number;
                }
                lanes
            }
        }
    })
}

/// Lane by lane, a sum.
#[inline(always)]
fn sum(mut left: Lanes, right: Lanes) -> Lanes {
    for (left, right) in left.iter_mut().zip(right) {
        *left += right;
    }
    left
}

/// Lane by lane, a product.
#[inline(always)]
fn product(mut left: Lanes, right: Lanes) -> Lanes {
    for (left, right) in left.iter_mut().zip(right) {
        *left *= right;
    }
    left
}

/// A function of every lane.
#[inline(always)]
fn each(mut lanes: Lanes, function: impl Fn(f32) -> f32) -> Lanes {
    for lane in &mut lanes {
        *lane = function(*lane);
    }
    lanes
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
        for (to, first) in to.chunks_mut(LANES).zip((0..).step_by(LANES)) {
            let [x_update, x_reset, x_candidate] = lanes(input, first);
            let [h_update, h_reset, h_candidate] = lanes(recurrent, first);
            let [state] = lanes([state], first);
            let update = each(sum(x_update, h_update), sigmoid);
            let reset = each(sum(x_reset, h_reset), sigmoid);
            let candidate = each(sum(x_candidate, product(reset, h_candidate)), tanh);
            let moved = product(update, sum(state, each(candidate, |n| -n)));
            let next = sum(candidate, moved);
            for (to, next) in to.iter_mut().zip(next) {
                *to = next;
            }
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
        let results = to.chunks_mut(LANES).zip(cell_to.chunks_mut(LANES));
        for ((to, cell_to), first) in results.zip((0..).step_by(LANES)) {
            let (x, h, b) = (lanes(input, first), lanes(recurrent, first), lanes(bias, first));
            let [x_input, x_output, x_forget, x_candidate] = x;
            let [h_input, h_output, h_forget, h_candidate] = h;
            let [b_input, b_output, b_forget, b_candidate] = b;
            let [cell] = lanes([&*cell], first);
            let gate = |x, h, b| sum(sum(x, h), b);
            let open = each(gate(x_input, h_input, b_input), sigmoid);
            let output = each(gate(x_output, h_output, b_output), sigmoid);
            let forget = each(gate(x_forget, h_forget, b_forget), sigmoid);
            let candidate = each(gate(x_candidate, h_candidate, b_candidate), tanh);
            let next = sum(product(forget, cell), product(open, candidate));
            let state = product(output, each(next, tanh));
            for ((to, state), (cell_to, next)) in
                to.iter_mut().zip(state).zip(cell_to.iter_mut().zip(next))
            {
                (*to, *cell_to) = (state, next);
            }
        }
        Ok(())
    }
}
