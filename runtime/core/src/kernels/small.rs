//! The kernels of processors without vectors and with few registers: short loops, in which flash counts as much as time.
//!
//! Every sum is added up in the same order as everywhere, so that bits are the same. Sums of sixteen columns stay in
//! registers where there is a floating-point unit; where there is none, factors that are zero are left out, for then
//! looking is cheaper than multiplying.

#[cfg(all(feature = "dsp", target_arch = "arm"))]
mod dsp;
mod int8;
mod parts;
mod sums;
#[cfg(test)]
mod tests;

use core::marker::PhantomData;

use super::Kernels;
use super::arithmetic::Arithmetic;
use super::dot::{LANES, join};
use super::mark::{MARKED, Marks};
use super::patches::{self, AddRuns, FloatTiles, Fold, PatchLayer, Runs};
use super::product::{Around, Sparse, add_row, finished, tile_width};
use super::rows::Rows;
use super::several::Pair;
use crate::math::exp;

/// Columns whose sums are kept together.
const PART: usize = 16;

/// Columns of rows that are mixed together.
const MIXED: usize = 8;

/// Whether a multiplication takes so long that factors are looked at first.
const HAS_SOFT_FLOAT: bool = cfg!(not(target_abi = "eabihf"));

/// The kernels of processors without vectors.
#[derive(Debug)]
pub(super) struct Small<A, const SKIPS: bool = HAS_SOFT_FLOAT>(PhantomData<A>);

impl<A, const SKIPS: bool> Small<A, SKIPS> {
    /// The kernels.
    pub(super) const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<A, const SKIPS: bool> Clone for Small<A, SKIPS> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, const SKIPS: bool> Copy for Small<A, SKIPS> {}

impl<A: Arithmetic, const SKIPS: bool> Kernels for Small<A, SKIPS> {
    #[inline(never)]
    fn mark(self, values: &[f32], marks: &mut [Marks]) -> bool {
        let mut largest = 0;
        for (values, marks) in values.chunks(MARKED).zip(marks) {
            *marks = [0; 2];
            for (values, word) in values.chunks(MARKED / 2).zip(marks) {
                // From the last one on: each moves up those behind it.
                for value in values.iter().rev() {
                    let magnitude = value.to_bits() & 0x7fff_ffff;
                    *word = *word << 1 | u32::from(magnitude != 0);
                    largest = u32::max(largest, magnitude);
                }
            }
        }
        largest < 0x7f80_0000
    }

    #[inline(never)]
    fn product(self, weights: &[f32], inputs: &[f32], around: Around<'_>, outputs: &mut [f32]) {
        fill::<A>(weights, inputs.len(), around, outputs, Dense(inputs));
    }

    #[inline(never)]
    fn sparse_product(
        self,
        weights: &[f32],
        inputs: Sparse<'_>,
        around: Around<'_>,
        outputs: &mut [f32],
    ) {
        fill::<A>(weights, inputs.count, around, outputs, Marked(inputs));
    }

    fn products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
        for pair in pairs {
            self.product(weights, pair.inputs, around, pair.outputs);
        }
    }

    fn sparse_products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
        self.products(weights, pairs, around);
    }

    #[inline(never)]
    fn convolve(self, layer: &PatchLayer<'_>, from: &[f32], to: &mut [f32]) {
        let tiles = FloatTiles::<A, Self>::of(self, layer, from);
        patches::convolve::<1, 1>(&tiles, (layer.patches, layer.outputs), to);
    }

    #[inline(never)]
    fn fold(self, layer: &PatchLayer<'_>, by: Fold, from: &[f32], to: &mut [f32]) {
        patches::fold::<A>(layer, by, from, to);
    }

    #[inline(never)]
    fn dots(self, vector: &[f32], rows: Rows<'_>, products: &mut [f32]) {
        for (slot, product) in rows.slots.iter().zip(products) {
            *product = dot::<A, SKIPS>(vector, rows.row(*slot));
        }
    }

    #[inline(never)]
    fn softmax(self, scores: &mut [f32], count: usize) -> bool {
        softmax(scores, count)
    }

    #[inline(never)]
    fn mix(self, weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
        // Rows are padded to a multiple of eight.
        for (part, sums) in sums.as_chunks_mut().0.iter_mut().enumerate() {
            *sums = mixed::<A, SKIPS, MIXED>(weights, rows, part * MIXED);
        }
    }
}

impl<P, const SKIPS: bool> AddRuns for Small<P, SKIPS> {
    #[inline(always)]
    fn add_runs<A: Arithmetic, const COUNT: usize>(
        self,
        tile: &[[f32; PART]],
        runs: Runs<'_, f32>,
        at: [usize; COUNT],
        start: [f32; PART],
    ) -> [[f32; PART]; COUNT] {
        patches::add_runs::<A, COUNT>(tile, runs, at, start)
    }
}

/// Some columns of a tile: its floats from the first of them on, and the width of a row.
#[derive(Clone, Copy)]
struct Columns<'a> {
    floats: &'a [f32],
    width: usize,
}

/// What is multiplied with the rows of a matrix.
trait Inputs: Copy {
    /// Adds up the first columns of all rows.
    fn add<A: Arithmetic, const PART: usize>(self, rows: Columns<'_>, sums: &mut [f32; PART]);
}

/// All inputs.
#[derive(Clone, Copy)]
struct Dense<'a>(&'a [f32]);

/// Those that are not zero.
#[derive(Clone, Copy)]
struct Marked<'a>(Sparse<'a>);

impl Inputs for Dense<'_> {
    #[inline(always)]
    fn add<A: Arithmetic, const PART: usize>(self, rows: Columns<'_>, sums: &mut [f32; PART]) {
        for (input, row) in self.0.iter().zip(rows.floats.chunks(rows.width.max(1))) {
            if let Some(columns) = row.first_chunk() {
                add_row::<A, PART>(sums, *input, columns);
            }
        }
    }
}

impl Inputs for Marked<'_> {
    #[inline(always)]
    fn add<A: Arithmetic, const PART: usize>(self, rows: Columns<'_>, sums: &mut [f32; PART]) {
        let Self(inputs) = self;
        let mut add = |index: usize, value: f32| {
            let row = rows.floats.get(index.saturating_mul(rows.width)..);
            if let Some(columns) = row.and_then(|row| row.first_chunk()) {
                add_row::<A, PART>(sums, value, columns);
            }
        };
        let words = inputs.marks.as_flattened().iter();
        for (first, word) in (0..).step_by(MARKED / 2).zip(words) {
            let mut marks = *word;
            while marks != 0 {
                let index = first + marks.trailing_zeros() as usize;
                marks &= marks - 1;
                let Some(value) = inputs.values.get(index) else { break };
                add(index, *value);
            }
        }
        if let Some(index) = inputs.one {
            add(index, 1.0);
        }
    }
}

/// Fills the outputs tile after tile, one code for tiles of all widths.
#[inline(always)]
fn fill<A: Arithmetic>(
    mut weights: &[f32],
    rows: usize,
    around: Around<'_>,
    mut outputs: &mut [f32],
    inputs: impl Inputs,
) {
    let mut bias = around.bias;
    while !outputs.is_empty() {
        let width = tile_width(outputs.len());
        let tile = weights.split_off(..rows.saturating_mul(width));
        let (Some(tile), Some(outputs)) = (tile, outputs.split_off_mut(..width)) else { return };
        let bias = bias.as_mut().and_then(|bias| bias.split_off(..width)).unwrap_or(&[]);
        let (parts, narrow) = outputs.as_chunks_mut::<PART>();
        for (part, outputs) in parts.iter_mut().enumerate() {
            fill_part::<A, PART>((tile, width), part * PART, bias, around.relu, outputs, inputs);
        }
        if let Some(outputs) = narrow.first_chunk_mut::<8>() {
            fill_part::<A, 8>((tile, width), 0, bias, around.relu, outputs, inputs);
        }
    }
}

/// Fills some outputs of a tile.
#[inline(always)]
fn fill_part<A: Arithmetic, const PART: usize>(
    (tile, width): (&[f32], usize),
    first: usize,
    bias: &[f32],
    relu: bool,
    outputs: &mut [f32; PART],
    inputs: impl Inputs,
) {
    let bias = bias.get(first..).and_then(|bias| bias.first_chunk());
    let mut sums = *bias.unwrap_or(&[0.0; PART]);
    let Some(floats) = tile.get(first..) else { return };
    inputs.add::<A, PART>(Columns { floats, width }, &mut sums);
    *outputs = finished(sums, relu);
}

/// The dot product of two vectors, padded to a multiple of eight, in lanes: eight after the other eight.
#[inline(always)]
fn dot<A: Arithmetic, const SKIPS: bool>(vector: &[f32], row: &[f32]) -> f32 {
    let mut sums = [[0.0; LANES / 2]; 2];
    let [first, second] = &mut sums;
    let add = |sums: &mut [f32; LANES / 2], (a, b): (&[f32; LANES / 2], &[f32; LANES / 2])| {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            add_product::<A, SKIPS>(sum, *a, *b);
        }
    };
    let mut eights = vector.as_chunks().0.iter().zip(row.as_chunks().0);
    while let Some(eight) = eights.next() {
        add(first, eight);
        if let Some(eight) = eights.next() {
            add(second, eight);
        }
    }
    join(*sums.as_flattened().first_chunk().unwrap_or(&[0.0; LANES]))
}

/// The weighted sum of some columns of rows.
#[inline(always)]
fn mixed<A: Arithmetic, const SKIPS: bool, const WIDTH: usize>(
    weights: &[f32],
    rows: Rows<'_>,
    first: usize,
) -> [f32; WIDTH] {
    let mut sums = [0.0; WIDTH];
    for (weight, slot) in weights.iter().zip(rows.slots) {
        let columns = rows.row(*slot).get(first..).and_then(|row| row.first_chunk::<WIDTH>());
        for (sum, column) in sums.iter_mut().zip(columns.into_iter().flatten()) {
            add_product::<A, SKIPS>(sum, *weight, *column);
        }
    }
    sums
}

/// Adds a product to a sum that is not -0. One with a zero of a row adds nothing, unless the other factor is no finite number.
#[inline(always)]
fn add_product<A: Arithmetic, const SKIPS: bool>(sum: &mut f32, a: f32, of_row: f32) {
    if !SKIPS || of_row.to_bits() != 0 || a.to_bits() & 0x7f80_0000 == 0x7f80_0000 {
        *sum = A::multiply_add(*sum, a, of_row);
    }
}

/// [`super::softmax::softmax`], score after score.
#[inline(always)]
fn softmax(scores: &mut [f32], count: usize) -> bool {
    let (real, behind) = scores.split_at_mut(count.min(scores.len()));
    let (mut magnitude, mut largest) = (0, f32::MIN);
    for score in &*real {
        magnitude = u32::max(magnitude, score.to_bits() & 0x7fff_ffff);
        largest = if *score > largest { *score } else { largest };
    }
    let mut sums = [0.0; LANES];
    for scores in real.chunks_mut(LANES) {
        for (score, sum) in scores.iter_mut().zip(&mut sums) {
            *score = power(*score - largest);
            *sum += *score;
        }
    }
    let scale = 1.0 / join(sums);
    real.iter_mut().for_each(|weight| *weight *= scale);
    behind.fill(0.0);
    magnitude < 0x7f80_0000
}

/// A power of e, once in flash.
#[inline(never)]
fn power(x: f32) -> f32 {
    exp(x)
}
