//! The kernels for AVX2 and AVX-512.
//!
//! Both are the portable code, compiled once more. Only what the compiler does not find by itself is written
//! with intrinsics: comparing eight values into a byte, and the four dot products that end in one tree.

use core::arch::x86_64::{
    __m128, __m256, __m512, _CMP_NEQ_UQ, _mm_add_ps, _mm256_add_ps, _mm256_castps256_ps128,
    _mm256_cmp_ps, _mm256_extractf128_ps, _mm256_fmadd_ps, _mm256_hadd_ps, _mm256_movemask_ps,
    _mm256_mul_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm512_add_ps, _mm512_fmadd_ps,
    _mm512_mul_ps, _mm512_set1_ps,
};
use core::marker::PhantomData;

use zerocopy::transmute;

use super::Kernels;
use super::arithmetic::Arithmetic;
use super::dot::{self, ROWS};
use super::mark::{self, LANES, Marks};
use super::product::{self, Around, Sparse};
use super::rows::Rows;
use super::several::{self, AddRows, Pair, STRIP};
use super::softmax;

/// A bit for each value that is not zero.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn lanes_not_zero(values: &[f32; LANES]) -> u8 {
    let values: __m256 = transmute!(*values);
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NEQ_UQ>(values, _mm256_setzero_ps())) as u8
}

/// The dot products of a vector with four rows: see [`dot::four_dots`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn four_dots<A: Arithmetic>(vector: &[f32], rows: [&[f32]; ROWS]) -> [f32; ROWS] {
    let multiply_add = |sum: __m256, a: __m256, b: __m256| {
        if A::FUSED { _mm256_fmadd_ps(a, b, sum) } else { _mm256_add_ps(sum, _mm256_mul_ps(a, b)) }
    };
    let load = |lanes: &[f32; LANES]| -> __m256 { transmute!(*lanes) };
    let (pairs, rest) = vector.as_chunks::<LANES>().0.as_chunks::<2>();
    let [r0, r1, r2, r3] = rows.map(|row| row.as_chunks::<LANES>().0.as_chunks::<2>());
    let mut low = [_mm256_setzero_ps(); ROWS];
    let mut high = low;
    let rows = r0.0.iter().zip(r1.0).zip(r2.0).zip(r3.0);
    for ([low_v, high_v], (((r0, r1), r2), r3)) in pairs.iter().zip(rows) {
        let (low_v, high_v) = (load(low_v), load(high_v));
        let sums = low.iter_mut().zip(&mut high);
        for ((low, high), [low_row, high_row]) in sums.zip([r0, r1, r2, r3]) {
            *low = multiply_add(*low, low_v, load(low_row));
            *high = multiply_add(*high, high_v, load(high_row));
        }
    }
    let rows = [r0.1, r1.1, r2.1, r3.1];
    for (low, row) in low.iter_mut().zip(rows) {
        if let (Some(v), Some(row)) = (rest.first(), row.first()) {
            *low = multiply_add(*low, load(v), load(row));
        }
    }
    let [a, b, c, d] = low;
    let [e, f, g, h] = high;
    let [a, b] = [_mm256_add_ps(a, e), _mm256_add_ps(b, f)];
    let [c, d] = [_mm256_add_ps(c, g), _mm256_add_ps(d, h)];
    let neighbours = _mm256_hadd_ps(_mm256_hadd_ps(a, b), _mm256_hadd_ps(c, d));
    let halves = [_mm256_castps256_ps128(neighbours), _mm256_extractf128_ps::<1>(neighbours)];
    let [first, second]: [__m128; 2] = halves;
    transmute!(_mm_add_ps(first, second))
}

/// [`AddRows`] in two vectors of eight columns.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn add_rows_avx2<A: Arithmetic, const WIDTH: usize, const COUNT: usize>(
    rows: &[[f32; WIDTH]],
    part: usize,
    start: [f32; STRIP],
    inputs: [&[f32]; COUNT],
) -> [[f32; STRIP]; COUNT] {
    let start: [__m256; 2] = transmute!(start);
    let mut sums = [start; COUNT];
    // One way out, so that the lengths of all inputs are compared once.
    'rows: for (index, row) in rows.iter().enumerate() {
        let Some(row) = row.as_chunks::<STRIP>().0.get(part) else { break };
        let weights: [__m256; 2] = transmute!(*row);
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            let Some(input) = inputs.get(index) else { break 'rows };
            let input = _mm256_set1_ps(*input);
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum = if A::FUSED {
                    _mm256_fmadd_ps(input, weight, *sum)
                } else {
                    _mm256_add_ps(*sum, _mm256_mul_ps(input, weight))
                };
            }
        }
    }
    sums.map(|sums| transmute!(sums))
}

/// [`AddRows`] in one vector of sixteen columns.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn add_rows_avx512<A: Arithmetic, const WIDTH: usize, const COUNT: usize>(
    rows: &[[f32; WIDTH]],
    part: usize,
    start: [f32; STRIP],
    inputs: [&[f32]; COUNT],
) -> [[f32; STRIP]; COUNT] {
    let add = |sums: &mut [__m512; COUNT], row: &[f32; WIDTH], inputs: [f32; COUNT]| {
        let Some(row) = row.as_chunks::<STRIP>().0.get(part) else { return };
        let weights: __m512 = transmute!(*row);
        for (sum, input) in sums.iter_mut().zip(inputs) {
            let input = _mm512_set1_ps(input);
            *sum = if A::FUSED {
                _mm512_fmadd_ps(input, weights, *sum)
            } else {
                _mm512_add_ps(*sum, _mm512_mul_ps(input, weights))
            };
        }
    };
    let start: __m512 = transmute!(start);
    let mut sums = [start; COUNT];
    // Four rows a turn, so that counting and checking cost little beside so few instructions.
    let (groups, rest) = rows.as_chunks::<4>();
    let inputs = inputs.map(|inputs| inputs.as_chunks::<4>());
    for (index, [a, b, c, d]) in groups.iter().enumerate() {
        let inputs = inputs.map(|(groups, _)| groups.get(index).unwrap_or(&[0.0; 4]));
        add(&mut sums, a, inputs.map(|[input, _, _, _]| *input));
        add(&mut sums, b, inputs.map(|[_, input, _, _]| *input));
        add(&mut sums, c, inputs.map(|[_, _, input, _]| *input));
        add(&mut sums, d, inputs.map(|[_, _, _, input]| *input));
    }
    for (index, row) in rest.iter().enumerate() {
        add(&mut sums, row, inputs.map(|(_, rest)| rest.get(index).copied().unwrap_or(0.0)));
    }
    sums.map(|sums| transmute!(sums))
}

/// Builds all kernels for an instruction set.
macro_rules! build {
    ($(#[$doc:meta])* $name:ident, $module:ident, $add_rows:ident, $features:literal) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub(super) struct $name<A>(PhantomData<A>);

        impl<A> $name<A> {
            /// # Safety
            /// The processor has all features of the build.
            #[allow(unsafe_code)]
            pub(super) const unsafe fn new() -> Self {
                Self(PhantomData)
            }
        }

        impl<A> Clone for $name<A> {
            fn clone(&self) -> Self {
                *self
            }
        }

        impl<A> Copy for $name<A> {}

        // SAFETY (all calls): a value of this type exists only where the processor has the features, which is
        // the one obligation of calling a function that is built with them.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<A: Arithmetic> Kernels for $name<A> {
            #[inline]
            fn mark(self, values: &[f32], marks: &mut [Marks]) -> bool {
                unsafe { $module::mark(values, marks) }
            }

            #[inline]
            fn product(
                self,
                weights: &[f32],
                inputs: &[f32],
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                unsafe { $module::product::<A>(weights, inputs, around, outputs) }
            }

            #[inline]
            fn sparse_product(
                self,
                weights: &[f32],
                inputs: Sparse<'_>,
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                unsafe { $module::sparse_product::<A>(weights, inputs, around, outputs) }
            }

            #[inline]
            fn products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
                unsafe { $module::products::<A>(self, weights, pairs, around) }
            }

            #[inline]
            fn dots(self, vector: &[f32], rows: Rows<'_>, products: &mut [f32]) {
                unsafe { $module::dots::<A>(vector, rows, products) }
            }

            #[inline]
            fn softmax(self, scores: &mut [f32], count: usize) -> bool {
                unsafe { $module::softmax(scores, count) }
            }

            #[inline]
            fn mix(self, weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
                unsafe { $module::mix::<A>(weights, rows, sums) }
            }
        }

        // SAFETY: as above.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<P> AddRows for $name<P> {
            #[inline(always)]
            fn add_rows<A: Arithmetic, const WIDTH: usize, const COUNT: usize>(
                self,
                rows: &[[f32; WIDTH]],
                part: usize,
                start: [f32; STRIP],
                inputs: [&[f32]; COUNT],
            ) -> [[f32; STRIP]; COUNT] {
                unsafe { $add_rows::<A, WIDTH, COUNT>(rows, part, start, inputs) }
            }
        }

        mod $module {
            use super::*;

            #[target_feature(enable = $features)]
            pub(super) fn mark(values: &[f32], marks: &mut [Marks]) -> bool {
                mark::mark(values, marks, |lanes| lanes_not_zero(lanes))
            }

            #[target_feature(enable = $features)]
            pub(super) fn product<A: Arithmetic>(
                weights: &[f32],
                inputs: &[f32],
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                product::product::<A>(weights, inputs, around, outputs);
            }

            #[target_feature(enable = $features)]
            pub(super) fn sparse_product<A: Arithmetic>(
                weights: &[f32],
                inputs: Sparse<'_>,
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                product::sparse_product::<A>(weights, inputs, around, outputs);
            }

            #[target_feature(enable = $features)]
            pub(super) fn products<A: Arithmetic>(
                kernels: $name<A>,
                weights: &[f32],
                pairs: &mut [Pair<'_>],
                around: Around<'_>,
            ) {
                several::products::<A>(kernels, weights, pairs, around);
            }

            #[target_feature(enable = $features)]
            pub(super) fn dots<A: Arithmetic>(vector: &[f32], rows: Rows<'_>, products: &mut [f32]) {
                dot::dots(vector, rows, products, |vector, rows| four_dots::<A>(vector, rows));
            }

            #[target_feature(enable = $features)]
            pub(super) fn softmax(scores: &mut [f32], count: usize) -> bool {
                softmax::softmax(scores, count)
            }

            #[target_feature(enable = $features)]
            pub(super) fn mix<A: Arithmetic>(weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
                product::mix::<A>(weights, rows, sums);
            }
        }
    };
}

build! {
    /// The kernels for processors with AVX2 and fused multiply-add.
    Avx2, avx2, add_rows_avx2, "avx2,fma,bmi1,bmi2,lzcnt,popcnt"
}

build! {
    /// The kernels for processors that also have AVX-512 and its instruction for integer networks.
    Avx512, avx512, add_rows_avx512,
    "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vnni"
}
