//! The kernels of processors without vectors and with few registers: short loops, in which flash counts as much as time.
//!
//! Every sum is added up in the same order as everywhere, so that bits are the same. Sums of sixteen columns stay in
//! registers where there is a floating-point unit; where there is none, factors that are zero are left out, for then
//! looking is cheaper than multiplying.

mod int8;
#[cfg(test)]
mod tests;

use core::marker::PhantomData;

use super::Kernels;
use super::arithmetic::Arithmetic;
use super::dot::{LANES, join};
use super::mark::{MARKED, Marks};
use super::product::{Around, Sparse, Tile, Tiles, add_row, finished};
use super::rows::Rows;
use super::several::Pair;
use crate::math::exp;

/// Columns whose sums are kept together.
const PART: usize = 16;

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
        let (parts, rest) = sums.as_chunks_mut::<PART>();
        for (part, sums) in parts.iter_mut().enumerate() {
            *sums = mixed::<A, SKIPS, PART>(weights, rows, part * PART);
        }
        // Rows are padded to a multiple of eight.
        if let Some(sums) = rest.first_chunk_mut() {
            *sums = mixed::<A, SKIPS, 8>(weights, rows, parts.len() * PART);
        }
    }
}

/// What is multiplied with the rows of a matrix.
trait Inputs: Copy {
    /// Adds up some columns of all rows, `PART` from `part` times as many on.
    fn add<A: Arithmetic, const WIDTH: usize, const PART: usize>(
        self,
        rows: &[[f32; WIDTH]],
        part: usize,
        sums: &mut [f32; PART],
    );
}

/// All inputs.
#[derive(Clone, Copy)]
struct Dense<'a>(&'a [f32]);

/// Those that are not zero.
#[derive(Clone, Copy)]
struct Marked<'a>(Sparse<'a>);

impl Inputs for Dense<'_> {
    #[inline(always)]
    fn add<A: Arithmetic, const WIDTH: usize, const PART: usize>(
        self,
        rows: &[[f32; WIDTH]],
        part: usize,
        sums: &mut [f32; PART],
    ) {
        for (input, row) in self.0.iter().zip(rows) {
            add_part::<A, WIDTH, PART>(sums, *input, row, part);
        }
    }
}

impl Inputs for Marked<'_> {
    #[inline(always)]
    fn add<A: Arithmetic, const WIDTH: usize, const PART: usize>(
        self,
        rows: &[[f32; WIDTH]],
        part: usize,
        sums: &mut [f32; PART],
    ) {
        let Self(inputs) = self;
        let words = inputs.marks.as_flattened().iter();
        let halves = inputs.values.chunks(MARKED / 2).zip(rows.chunks(MARKED / 2));
        for (word, (values, rows)) in words.zip(halves) {
            let mut marks = *word;
            while marks != 0 {
                let index = marks.trailing_zeros() as usize;
                marks &= marks - 1;
                let (Some(value), Some(row)) = (values.get(index), rows.get(index)) else { break };
                add_part::<A, WIDTH, PART>(sums, *value, row, part);
            }
        }
        if let Some(row) = inputs.one.and_then(|index| rows.get(index)) {
            add_part::<A, WIDTH, PART>(sums, 1.0, row, part);
        }
    }
}

#[inline(always)]
fn add_part<A: Arithmetic, const WIDTH: usize, const PART: usize>(
    sums: &mut [f32; PART],
    input: f32,
    row: &[f32; WIDTH],
    part: usize,
) {
    if let Some(columns) = row.as_chunks::<PART>().0.get(part) {
        add_row::<A, PART>(sums, input, columns);
    }
}

/// Fills the outputs tile after tile.
#[inline(always)]
fn fill<A: Arithmetic>(
    weights: &[f32],
    rows: usize,
    around: Around<'_>,
    outputs: &mut [f32],
    inputs: impl Inputs,
) {
    let mut tiles = Tiles::new(weights, rows, around, outputs);
    while let Some(tile) = tiles.next::<64>() {
        fill_tile::<A, 64, PART>(tile, inputs);
    }
    if let Some(tile) = tiles.next::<32>() {
        fill_tile::<A, 32, PART>(tile, inputs);
    }
    if let Some(tile) = tiles.next::<16>() {
        fill_tile::<A, 16, PART>(tile, inputs);
    }
    if let Some(tile) = tiles.next::<8>() {
        fill_tile::<A, 8, 8>(tile, inputs);
    }
}

#[inline(always)]
fn fill_tile<A: Arithmetic, const WIDTH: usize, const PART: usize>(
    tile: Tile<'_, '_, WIDTH>,
    inputs: impl Inputs,
) {
    let (starts, _) = tile.start.as_chunks::<PART>();
    let (columns, _) = tile.columns.as_chunks_mut::<PART>();
    for (part, (start, columns)) in starts.iter().zip(columns).enumerate() {
        let mut sums = *start;
        inputs.add::<A, WIDTH, PART>(tile.rows, part, &mut sums);
        *columns = finished(sums, tile.relu);
    }
}

/// The dot product of two vectors, in lanes.
#[inline(always)]
fn dot<A: Arithmetic, const SKIPS: bool>(vector: &[f32], row: &[f32]) -> f32 {
    let mut sums = [0.0; LANES];
    let (chunks, rest) = vector.as_chunks::<LANES>();
    let (columns, last) = row.as_chunks::<LANES>();
    for (chunk, columns) in chunks.iter().zip(columns) {
        for ((sum, a), b) in sums.iter_mut().zip(chunk).zip(columns) {
            add_product::<A, SKIPS>(sum, *a, *b);
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(rest).zip(last) {
        add_product::<A, SKIPS>(sum, *a, *b);
    }
    join(sums)
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
