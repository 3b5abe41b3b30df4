//! A layer of int8 weights on every patch of a picture.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::int8_layer::{integers, quantised_floats};
use super::operator::Operator;
use super::steps::patches::fit;
use super::{Flag, LAYOUT_INT8, Place, Places, Scratch, Sizes, places, slice};
use crate::kernels::Kernels;
use crate::kernels::int8::{Int8PatchLayer, Reach, Row, STRIP};
use crate::kernels::patches::Patches;
use crate::policy::{DecideError, Observation};

/// Floats of one row of weights.
const ROW_FLOATS: u64 = (size_of::<Row>() / size_of::<f32>()) as u64;

/// As [`super::ConvolvePatches`], of int8 weights; the picture is quantised as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8ConvolvePatches {
    /// Rows of 16 outputs, strip after strip: in each a row for every pair of numbers of every run.
    pub weights: u32,
    /// What a weight of each output counts, f32, whole strips.
    pub steps: u32,
    /// Bias, f32, whole strips.
    pub bias: u32,
    /// Outputs: numbers side by side for every patch.
    pub outputs: u32,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// The patches.
    pub patches: Patches,
    /// The picture.
    pub from: Place,
    /// The result, apart from it. What lies between results stays as it is.
    pub to: Place,
    /// The quantised picture, and a zero behind it.
    pub quantised: Place,
}

impl Int8ConvolvePatches {
    /// Integers that are added up for an output.
    fn inputs(&self) -> u64 {
        let pairs = u64::from(self.patches.run.div_ceil(2));
        self.patches.total_runs().saturating_mul(2 * pairs)
    }

    fn columns(&self) -> u64 {
        u64::from(self.outputs).next_multiple_of(STRIP as u64)
    }

    /// Floats of the weights.
    pub fn weights_len(&self) -> u64 {
        let rows = (self.inputs() / 2).saturating_mul(self.columns() / STRIP as u64);
        rows.saturating_mul(ROW_FLOATS)
    }
}

/// Floats of a quantised picture, and a zero behind it: with an odd run its next number is read.
pub const fn quantised_picture(numbers: usize) -> usize {
    quantised_floats(numbers.saturating_add(1))
}

impl Operator for Int8ConvolvePatches {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        fit(&self.patches, self.outputs, [&self.from, &self.to])
            && sizes.holds_weights(self.weights, self.weights_len())
            && sizes.holds_weights(self.steps, self.columns())
            && sizes.holds_weights(self.bias, self.columns())
            && sizes.hold_apart(&[&self.from, &self.to, &self.quantised])
            && self.quantised.len as usize == quantised_picture(self.from.len as usize)
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        // The quantised picture is nobody else's to read.
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        let of_patch = self.patches.inputs().saturating_mul(self.columns());
        of_patch.saturating_mul(self.patches.total())
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let len = |len: u64| usize::try_from(len).unwrap_or(usize::MAX);
        let columns = len(self.columns());
        let rows = slice(weights, self.weights, len(self.weights_len()))?.as_bytes();
        let layer = Int8PatchLayer {
            patches: &self.patches,
            rows: <[Row]>::ref_from_bytes(rows).map_err(|_| DecideError::BadLength)?,
            steps: slice(weights, self.steps, columns)?,
            bias: slice(weights, self.bias, columns)?,
            relu: self.relu.is_set(),
            outputs: self.outputs as usize,
        };
        let wanted = [&self.from, &self.quantised, &self.to];
        let [from, quantised, to] = places(scratch.floats, wanted)?;
        let integers = integers(quantised, from.len().saturating_add(1))?;
        let reach = Reach::of_inputs(len(self.inputs()));
        let scale = kernels.quantise(from, reach, integers).ok_or(DecideError::NonFinite)?;
        kernels.int8_convolve(&layer, integers, scale.step, to);
        Ok(())
    }
}
