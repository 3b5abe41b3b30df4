//! The int8 kernels as every processor of the target runs them.

use super::{
    Count, Inputs, Int8Kernels, Int8PatchLayer, IntegerRows, IntegerTiles, Lanes, Marked, Matrix,
    PAIRS, Pair, Reach, Row, STRIP, Scale, SparseVector, Strips, Vector, narrow, products,
    quantise, sparse_product,
};
use crate::kernels::Portable;
use crate::kernels::patches::{Runs, convolve};
use crate::math::relu;

impl<A> Lanes for Portable<A> {
    #[inline(always)]
    fn largest_magnitude(self, values: &[f32]) -> u32 {
        let magnitude = |value: &f32| value.to_bits() & 0x7fff_ffff;
        values.iter().map(magnitude).fold(0, u32::max)
    }

    #[inline(always)]
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
        values.map(|value| scale.integer(value))
    }

    #[inline(always)]
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        let mut numbers = [0.0; STRIP];
        let counts = count.steps.iter().zip(count.bias);
        for ((number, sum), (step, bias)) in numbers.iter_mut().zip(sums).zip(counts) {
            let sum = *sum as f32 * (count.step * step) + bias;
            *number = if count.relu { relu(sum) } else { sum };
        }
        numbers
    }

    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        let mut sums = [[0; STRIP]; COUNT];
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            add_rows(sums, rows, inputs);
        }
        sums
    }

    #[inline(always)]
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        super::add_runs(rows, runs, at, add_row)
    }

    #[inline(always)]
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
        let mut sums = [[0; STRIP]; 2];
        for (sums, rows) in sums.iter_mut().zip(rows) {
            add_rows(sums, rows, inputs);
        }
        sums
    }

    #[inline(always)]
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: Marked<'_>,
        outputs: &mut [f32],
    ) {
        let mut sums = [[0; STRIP]; COUNT];
        strips.for_each::<COUNT>(inputs, not_zero, |rows, pair| {
            for (sums, row) in sums.iter_mut().zip(rows) {
                add_row(sums, row, pair);
            }
        });
        strips.matrix.finish(self, strips.first, &sums, inputs.step, outputs);
    }
}

/// A bit for each pair of values that is not zero.
fn not_zero(values: &[f32; STRIP]) -> u8 {
    let mut marks = 0;
    for (index, pair) in values.as_chunks().0.iter().enumerate() {
        marks |= u8::from(*pair != [0.0; 2]) << index;
    }
    marks
}

#[inline(always)]
fn add_rows(sums: &mut [i32; STRIP], rows: &[[Row; PAIRS]], inputs: &[Inputs]) {
    for (row, pair) in rows.as_flattened().iter().zip(inputs.as_flattened()) {
        add_row(sums, row, *pair);
    }
}

#[inline(always)]
fn add_row(sums: &mut [i32; STRIP], row: &Row, [first, second]: Pair) {
    let (first, second) = (i32::from(first), i32::from(second));
    for (sum, [a, b]) in sums.iter_mut().zip(row.as_chunks().0) {
        // Never wraps, see `input_max`.
        *sum = sum.wrapping_add(i32::from(*a) * first + i32::from(*b) * second);
    }
}

impl<A> Int8Kernels for Portable<A> {
    fn quantise(self, values: &[f32], reach: Reach, integers: &mut [i16]) -> Option<Scale> {
        quantise(self, values, reach, integers)
    }

    fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
        products(self, matrix, vectors);
    }

    fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: SparseVector<'_>) -> Option<()> {
        sparse_product(self, matrix, vector)
    }

    fn int8_convolve(
        self,
        layer: &Int8PatchLayer<'_>,
        integers: &[i16],
        step: f32,
        to: &mut [f32],
    ) {
        let tiles = IntegerTiles::of(self, layer, (integers, step));
        convolve::<4, 1>(&tiles, (layer.patches, layer.outputs), to);
    }

    fn int8_dots(self, vector: &[i16], step: f32, rows: IntegerRows<'_>, products: &mut [f32]) {
        for (slot, product) in rows.slots.iter().zip(products) {
            let (row, row_step) = rows.row(*slot);
            // Never wraps, see `row_max`.
            let sum = vector
                .iter()
                .zip(row)
                .fold(0_i32, |sum, (a, b)| sum.wrapping_add(i32::from(*a) * i32::from(*b)));
            *product = sum as f32 * (step * row_step);
        }
    }

    fn int8_mix(self, weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
        sums.fill(0);
        for (slot, weight) in rows.slots.iter().zip(weights) {
            for (sum, integer) in sums.iter_mut().zip(rows.row(*slot).0) {
                // Never wraps, see `mixing_max`.
                *sum = sum.wrapping_add(i32::from(*weight) * i32::from(*integer));
            }
        }
    }

    fn narrow(self, sums: &[i32], most: u16, integers: &mut [i16]) -> f32 {
        narrow(sums, most, integers)
    }
}
