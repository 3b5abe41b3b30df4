//! A layer on every row of a value.

use heapless::Vec;
use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Flag, LAYOUT_TILES, Linear, Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::several::Pair;
use crate::policy::{DecideError, Observation};

/// Rows that are worked on together.
const TOGETHER: usize = 8;

/// `W x + b` of every row x, with a ReLU where one follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct DenseRows {
    /// The layer.
    pub layer: Linear,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// Rows.
    pub rows: u32,
    /// The rows, each as long as the layer's inputs.
    pub from: Place,
    /// The results, each as long as the layer's outputs, the padding of the last behind it.
    pub to: Place,
}

impl DenseRows {
    /// Floats of all rows of the result but the last, and of that with its padding.
    fn result_len(&self) -> u64 {
        let before = u64::from(self.rows.saturating_sub(1)) * u64::from(self.layer.outputs);
        before + self.layer.padded_outputs() as u64
    }
}

impl Operator for DenseRows {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        self.rows > 0
            && self.layer.check(sizes)
            && sizes.hold_apart(&[&self.from, &self.to])
            && u64::from(self.from.len) == u64::from(self.rows) * u64::from(self.layer.inputs)
            && u64::from(self.to.len) == self.result_len()
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        self.layer.multiply_adds().saturating_mul(self.rows.into())
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let matrix = self.layer.matrix(weights)?;
        let around = self.layer.around(weights, self.relu.is_set())?;
        let [from, to] = places(scratch.floats, [&self.from, &self.to])?;
        let (inputs, outputs) = (usize::from(self.layer.inputs), usize::from(self.layer.outputs));
        let padded = self.layer.padded_outputs();
        if padded != outputs {
            // A row's padding is written over by the next row.
            for (row, from) in from.chunks_exact(inputs.max(1)).enumerate() {
                let to = to.get_mut(row * outputs..).and_then(|to| to.get_mut(..padded));
                kernels.product(matrix, from, around, to.ok_or(DecideError::BadLength)?);
            }
            return Ok(());
        }
        // Not two lists of chunks in step, whose lengths are divided for: of those a path to a panic is left on boards.
        let mut rest = to;
        for from in from.chunks(inputs.saturating_mul(TOGETHER).max(1)) {
            let several = outputs.saturating_mul(TOGETHER).min(rest.len());
            let to = rest.split_off_mut(..several).ok_or(DecideError::BadLength)?;
            let pairs = from.chunks_exact(inputs.max(1)).zip(to.chunks_exact_mut(outputs.max(1)));
            let pairs = pairs.map(|(inputs, outputs)| Pair { inputs, outputs });
            let mut pairs: Vec<Pair<'_>, TOGETHER> = pairs.take(TOGETHER).collect();
            kernels.products(matrix, &mut pairs, around);
        }
        Ok(())
    }
}
