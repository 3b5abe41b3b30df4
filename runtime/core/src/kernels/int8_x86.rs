//! The int8 kernels for AVX2, and for AVX-512 with its instruction for integer networks (VNNI).
//!
//! Both multiply pairs of int16 and add the two products in i32; bytes of weights are widened on the way. What is
//! written with intrinsics is this alone: all else is the portable code, compiled once more.

mod avx2;
mod avx512;
mod products;

use super::int8::{
    Count, Inputs, Int8Kernels, Int8PatchLayer, IntegerRows, IntegerTiles, Lanes, Marked, Matrix,
    PAIRS, Reach, Row, STRIP, Scale, SparseVector, Strips, Vector, narrow, products, quantise,
    sparse_product,
};
use super::patches::{self, Runs};
use super::x86::{Avx2, Avx512};

/// The bits of a number without its sign.
const MAGNITUDE: i32 = 0x7fff_ffff;

// SAFETY (all calls): a value of this type exists only where the processor has the features, which is the one
// obligation of calling a function that is built with them.
#[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
impl<A> Lanes for Avx2<A> {
    #[inline(always)]
    fn largest_magnitude(self, values: &[f32]) -> u32 {
        unsafe { avx2::largest_magnitude(values) }
    }

    #[inline(always)]
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
        unsafe { avx2::integers(scale, values) }
    }

    #[inline(always)]
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        unsafe { avx2::numbers(sums, count) }
    }

    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        // Sixteen registers hold the sums of six vectors once, of one vector four times.
        if COUNT == 1 {
            unsafe { avx2::add_strip::<COUNT, PAIRS>(rows, inputs) }
        } else {
            unsafe { avx2::add_strip::<COUNT, 1>(rows, inputs) }
        }
    }

    #[inline(always)]
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { avx2::add_runs(rows, runs, at) }
    }

    #[inline(always)]
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
        unsafe { avx2::add_two_strips(rows, inputs) }
    }

    #[inline(always)]
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: Marked<'_>,
        outputs: &mut [f32],
    ) {
        unsafe { avx2::add_marked::<COUNT>(self, strips, inputs, outputs) }
    }
}

// SAFETY: as above.
#[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
impl<A> Lanes for Avx512<A> {
    #[inline(always)]
    fn largest_magnitude(self, values: &[f32]) -> u32 {
        unsafe { avx512::largest_magnitude(values) }
    }

    #[inline(always)]
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
        unsafe { avx512::integers(scale, values) }
    }

    #[inline(always)]
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        unsafe { avx512::numbers(sums, count) }
    }

    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { avx512::add_strip::<COUNT, PAIRS>(rows, inputs) }
    }

    #[inline(always)]
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { avx512::add_runs(rows, runs, at) }
    }

    #[inline(always)]
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
        unsafe { avx512::add_two_strips(rows, inputs) }
    }

    #[inline(always)]
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: Marked<'_>,
        outputs: &mut [f32],
    ) {
        unsafe { avx512::add_marked::<COUNT>(self, strips, inputs, outputs) }
    }
}

/// Builds the int8 kernels for an instruction set.
macro_rules! build {
    ($name:ident, $module:ident, $instructions:ident, $features:literal) => {
        // SAFETY: as above.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<A> Int8Kernels for $name<A> {
            #[inline]
            fn quantise(self, values: &[f32], reach: Reach, integers: &mut [i16]) -> Option<Scale> {
                unsafe { $module::quantise(self, values, reach, integers) }
            }

            #[inline]
            fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
                unsafe { $module::products(self, matrix, vectors) }
            }

            #[inline]
            fn int8_sparse_product(
                self,
                matrix: &Matrix<'_>,
                vector: SparseVector<'_>,
            ) -> Option<()> {
                unsafe { $module::sparse_product(self, matrix, vector) }
            }

            #[inline]
            fn int8_convolve(
                self,
                layer: &Int8PatchLayer<'_>,
                integers: &[i16],
                step: f32,
                to: &mut [f32],
            ) {
                unsafe { $module::convolve(self, layer, (integers, step), to) }
            }

            #[inline]
            fn int8_dots(
                self,
                vector: &[i16],
                step: f32,
                rows: IntegerRows<'_>,
                products: &mut [f32],
            ) {
                unsafe { $module::dots(vector, step, rows, products) }
            }

            #[inline]
            fn int8_mix(self, weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
                unsafe { $instructions::mix(weights, rows, sums) }
            }

            #[inline]
            fn narrow(self, sums: &[i32], most: u16, integers: &mut [i16]) -> f32 {
                unsafe { $module::narrow(sums, most, integers) }
            }
        }

        mod $module {
            use super::*;

            #[target_feature(enable = $features)]
            pub(super) fn quantise<A>(
                kernels: $name<A>,
                values: &[f32],
                reach: Reach,
                integers: &mut [i16],
            ) -> Option<Scale> {
                super::quantise(kernels, values, reach, integers)
            }

            #[target_feature(enable = $features)]
            pub(super) fn convolve<A>(
                kernels: $name<A>,
                layer: &Int8PatchLayer<'_>,
                integers: (&[i16], f32),
                to: &mut [f32],
            ) {
                const MANY: usize = $instructions::PATCHES;
                let tiles = IntegerTiles::of(kernels, layer, integers);
                let sizes = (layer.patches, layer.outputs);
                patches::convolve::<MANY, { MANY / 2 }>(&tiles, sizes, to);
            }

            #[target_feature(enable = $features)]
            pub(super) fn dots(
                vector: &[i16],
                step: f32,
                rows: IntegerRows<'_>,
                products: &mut [f32],
            ) {
                for (slot, product) in rows.slots.iter().zip(products) {
                    let (row, row_step) = rows.row(*slot);
                    *product = $instructions::dot(vector, row) as f32 * (step * row_step);
                }
            }

            #[target_feature(enable = $features)]
            pub(super) fn narrow(sums: &[i32], most: u16, integers: &mut [i16]) -> f32 {
                super::narrow(sums, most, integers)
            }

            #[target_feature(enable = $features)]
            pub(super) fn products<A>(
                kernels: $name<A>,
                matrix: &Matrix<'_>,
                vectors: &mut [Vector<'_>],
            ) {
                super::products(kernels, matrix, vectors);
            }

            #[target_feature(enable = $features)]
            pub(super) fn sparse_product<A>(
                kernels: $name<A>,
                matrix: &Matrix<'_>,
                vector: SparseVector<'_>,
            ) -> Option<()> {
                super::sparse_product(kernels, matrix, vector)
            }
        }
    };
}

build! { Avx2, with_avx2, avx2, "avx2,fma,bmi1,bmi2,lzcnt,popcnt" }

build! {
    Avx512, with_avx512, avx512,
    "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vnni"
}

impl Count<'_> {
    /// No number is less.
    #[inline(always)]
    fn least(&self) -> f32 {
        if self.relu { 0.0 } else { f32::NEG_INFINITY }
    }
}

/// Values with zeros behind them.
fn filled<const LANES: usize>(values: &[f32]) -> [f32; LANES] {
    let mut lanes = [0.0; LANES];
    for (lane, value) in lanes.iter_mut().zip(values) {
        *lane = *value;
    }
    lanes
}
