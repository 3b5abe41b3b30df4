//! Layers of int8 weights, and the products that the int8 operators are made of.

use heapless::Vec;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::team::{Member, TEAM, Team};
use super::{Place, Sizes, places, slice};
use crate::kernels::Kernels;
use crate::kernels::int8::{INPUTS, Inputs, Matrix, PAIRS, Reach, Row, STRIP, Scale, Vector};
use crate::kernels::product::padded;
use crate::policy::DecideError;

/// Floats of one row of weights.
const ROW_FLOATS: usize = size_of::<Row>() / size_of::<f32>();

/// A matrix of int8 weights with its steps and its bias: offsets into the weights, in floats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8Layer {
    /// Inputs.
    pub inputs: u16,
    /// Outputs.
    pub outputs: u16,
    /// Rows of the matrix (see [`crate::kernels::int8::Matrix`]).
    pub weights: u32,
    /// What a weight of each output counts, f32, whole strips.
    pub steps: u32,
    /// Bias, f32, whole strips.
    pub bias: u32,
}

/// The sizes of a matrix of int8 weights.
#[derive(Clone, Copy, Debug)]
pub(super) struct Int8Shape {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
}

impl Int8Shape {
    /// Groups of pairs of inputs.
    fn groups(self) -> usize {
        self.inputs.div_ceil(2 * PAIRS)
    }

    /// Floats of steps or bias: outputs, rounded up to whole strips.
    pub(super) fn columns(self) -> usize {
        self.outputs.div_ceil(STRIP).saturating_mul(STRIP)
    }

    /// Floats of the matrix.
    pub(super) fn weights_len(self) -> usize {
        let rows = self.groups().saturating_mul(self.columns() / STRIP).saturating_mul(PAIRS);
        rows.saturating_mul(ROW_FLOATS)
    }

    pub(super) fn multiply_adds(self) -> u64 {
        self.inputs as u64 * padded(self.outputs) as u64
    }

    /// The matrix without bias whose weights and steps start at the given floats.
    #[cfg_attr(target_os = "none", inline(never))]
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(super) fn matrix(
        self,
        floats: &[f32],
        weights: u32,
        steps: u32,
    ) -> Result<Matrix<'_>, DecideError> {
        let rows = slice(floats, weights, self.weights_len())?.as_bytes();
        let rows = <[Row]>::ref_from_bytes(rows).map_err(|_| DecideError::BadLength)?;
        let steps = slice(floats, steps, self.columns())?;
        Ok(Matrix { rows, groups: self.groups(), steps, bias: None, relu: false })
    }
}

impl Int8Layer {
    pub(super) fn shape(&self) -> Int8Shape {
        Int8Shape { inputs: self.inputs.into(), outputs: self.outputs.into() }
    }

    /// Outputs in the arena, rounded up as those of other layers are.
    pub const fn padded_outputs(&self) -> usize {
        padded(self.outputs as usize)
    }

    /// Floats of the matrix.
    pub fn weights_len(&self) -> usize {
        self.shape().weights_len()
    }

    pub(super) fn check(&self, sizes: &Sizes) -> bool {
        let (shape, columns) = (self.shape(), self.shape().columns() as u64);
        self.inputs > 0
            && self.outputs > 0
            && sizes.holds_weights(self.weights, shape.weights_len() as u64)
            && sizes.holds_weights(self.steps, columns)
            && sizes.holds_weights(self.bias, columns)
    }

    #[inline(always)]
    pub(super) fn matrix<'w>(
        &self,
        floats: &'w [f32],
        relu: bool,
    ) -> Result<Matrix<'w>, DecideError> {
        let bias = slice(floats, self.bias, self.shape().columns())?;
        let matrix = self.shape().matrix(floats, self.weights, self.steps)?;
        Ok(Matrix { bias: Some(bias), relu, ..matrix })
    }
}

/// Floats of the arena in which `inputs` quantised inputs have room.
pub const fn quantised_floats(inputs: usize) -> usize {
    inputs.div_ceil(INPUTS).saturating_mul(INPUTS / 2)
}

/// Floats of the arena as the quantised inputs of a layer.
#[inline(always)]
pub(super) fn integers(floats: &mut [f32], inputs: usize) -> Result<&mut [i16], DecideError> {
    let floats = floats.get_mut(..quantised_floats(inputs)).ok_or(DecideError::BadLength)?;
    <[i16]>::mut_from_bytes(floats.as_mut_bytes()).map_err(|_| DecideError::BadLength)
}

/// Floats of the arena as the integers that stand there.
#[inline(always)]
pub(super) fn as_integers(floats: &[f32]) -> Result<&[i16], DecideError> {
    <[i16]>::ref_from_bytes(floats.as_bytes()).map_err(|_| DecideError::BadLength)
}

/// Quantised inputs as kernels take them.
#[inline(always)]
pub(super) fn as_inputs(integers: &[i16]) -> &[Inputs] {
    integers.as_chunks().0.as_chunks().0
}

/// Quantises inputs at `quantised`.
#[inline(always)]
fn quantise<'q>(
    kernels: impl Kernels,
    values: &[f32],
    quantised: &'q mut [f32],
) -> Result<(&'q [Inputs], Scale), DecideError> {
    let integers = integers(quantised, values.len())?;
    let reach = Reach::of_inputs(integers.len());
    let scale = kernels.quantise(values, reach, integers).ok_or(DecideError::NonFinite)?;
    Ok((as_inputs(integers), scale))
}

/// Writes the product of a matrix and `from`, which is quantised at `quantised`.
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline(always))]
pub(super) fn product(
    kernels: impl Kernels,
    matrix: &Matrix<'_>,
    from: &[f32],
    quantised: &mut [f32],
    outputs: &mut [f32],
) -> Result<(), DecideError> {
    let (inputs, Scale { step, .. }) = quantise(kernels, from, quantised)?;
    kernels.int8_products(matrix, &mut [Vector { inputs, step, outputs }]);
    Ok(())
}

/// The integers that a product of a team is made with, among a member's own places.
#[derive(Clone, Copy)]
pub(super) enum From<'a> {
    /// Floats, which are quantised.
    Floats(&'a Place),
    /// What stands in `quantised` already: what an integer counts, by member.
    Quantised(&'a [f32; TEAM]),
}

/// Places of a team's products.
#[derive(Clone, Copy)]
pub(super) struct Between<'a> {
    pub(super) from: From<'a>,
    pub(super) quantised: &'a Place,
    pub(super) to: &'a Place,
}

/// As [`product`] for those members of a team that are `wanted`. Whose inputs are no numbers decides alone.
pub(super) fn team_products(
    kernels: impl Kernels,
    matrix: &Matrix<'_>,
    team: &mut Team<'_>,
    between: Between<'_>,
    wanted: impl Fn(&Member) -> bool,
) -> Result<(), DecideError> {
    let [quantised, to] = [between.quantised, between.to].map(|place| team.own_place(place));
    let own = match between.from {
        From::Floats(place) => team.own_place(place),
        // A place of nothing, which overlaps none.
        From::Quantised(_) => Place { offset: 0, len: 0 },
    };
    let mut vectors: Vec<Vector<'_>, TEAM> = Vec::new();
    for (index, (member, floats)) in team.own_places().enumerate() {
        if !wanted(member) {
            continue;
        }
        let [from, quantised, outputs] = places(floats, [&own, &quantised, &to])?;
        let inputs = match between.from {
            From::Floats(_) => quantise(kernels, from, quantised).map(|(i, scale)| (i, scale.step)),
            From::Quantised(steps) => {
                let step = steps.get(index).copied().unwrap_or(0.0);
                as_integers(quantised).map(|integers| (as_inputs(integers), step))
            }
        };
        match inputs {
            Ok((inputs, step)) => {
                // There is room for every member.
                let _ = vectors.push(Vector { inputs, step, outputs });
            }
            Err(_) => member.alone = true,
        }
    }
    kernels.int8_products(matrix, &mut vectors);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_whole_strips_and_pairs() {
        let len = |inputs, outputs| Int8Shape { inputs, outputs }.weights_len();
        assert_eq!([len(1, 1), len(8, 16), len(9, 17)], [32, 32, 128]);
        assert_eq!([quantised_floats(1), quantised_floats(32), quantised_floats(33)], [16, 16, 32]);
        assert_eq!(Int8Shape { inputs: 4, outputs: 12 }.columns(), 16);
    }
}
