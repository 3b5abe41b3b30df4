//! The int8 kernels for AVX2, and for AVX-512 with its instruction for integer networks (VNNI).
//!
//! Both multiply pairs of int16 and add the two products in i32; bytes of weights are widened on the way. What is
//! written with intrinsics is this alone: all else is the portable code, compiled once more.

use core::arch::x86_64::{
    __m128i, __m256i, __m512i, _mm256_add_epi32, _mm256_castsi256_ps, _mm256_cmpeq_epi32,
    _mm256_cvtepi8_epi16, _mm256_madd_epi16, _mm256_movemask_ps, _mm256_set1_epi32,
    _mm256_setzero_si256, _mm512_add_epi32, _mm512_cvtepi8_epi16, _mm512_dpwssd_epi32,
    _mm512_set1_epi32, _mm512_setzero_si512, _mm512_test_epi32_mask,
};

use zerocopy::transmute;

use super::int8::{
    AddPairs, Inputs, Int8Kernels, Matrix, PAIRS, Pair, Row, STRIP, Scale, Strips, Vector,
};
use super::int8::{products, quantise, sparse_product};
use super::x86::{Avx2, Avx512};

/// Sums of a strip, eight columns in each vector.
type Sums256 = [__m256i; 2];

/// Adds a row of weights, times its pair of inputs.
#[inline]
#[target_feature(enable = "avx2")]
fn add_row_avx2(sums: Sums256, row: &Row, inputs: Pair) -> Sums256 {
    let halves: [__m128i; 2] = transmute!(*row);
    let inputs = _mm256_set1_epi32(transmute!(inputs));
    let ([low, high], [a, b]) = (halves, sums);
    let low = _mm256_madd_epi16(_mm256_cvtepi8_epi16(low), inputs);
    let high = _mm256_madd_epi16(_mm256_cvtepi8_epi16(high), inputs);
    [_mm256_add_epi32(a, low), _mm256_add_epi32(b, high)]
}

/// Adds a row of weights, times its pair of inputs.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn add_row_avx512(sums: __m512i, row: &Row, inputs: Pair) -> __m512i {
    let row: __m256i = transmute!(*row);
    let inputs = _mm512_set1_epi32(transmute!(inputs));
    _mm512_dpwssd_epi32(sums, _mm512_cvtepi8_epi16(row), inputs)
}

/// [`AddPairs::add_strip`] with `SETS` sums for every column, so that additions need not wait for each other.
#[inline]
#[target_feature(enable = "avx2")]
fn add_strip_avx2<const COUNT: usize, const SETS: usize>(
    rows: &[[Row; PAIRS]],
    inputs: [&[Inputs]; COUNT],
) -> [[i32; STRIP]; COUNT] {
    let mut sums = [[[_mm256_setzero_si256(); 2]; SETS]; COUNT];
    for (index, rows) in rows.iter().enumerate() {
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            // Inputs do not end before the rows; zeros that stand for them need no way out of the loop.
            let inputs = inputs.get(index).unwrap_or(&[[0; 2]; PAIRS]);
            let sets = rows.as_chunks::<SETS>().0.iter().zip(inputs.as_chunks::<SETS>().0);
            for (rows, inputs) in sets {
                for ((sum, row), pair) in sums.iter_mut().zip(rows).zip(inputs) {
                    *sum = add_row_avx2(*sum, row, *pair);
                }
            }
        }
    }
    // Closures would stay calls: what maps arrays is not built for these instructions.
    let mut joined = [[0; STRIP]; COUNT];
    for (joined, sums) in joined.iter_mut().zip(sums) {
        let mut total = [_mm256_setzero_si256(); 2];
        for set in sums {
            let ([a, b], [c, d]) = (total, set);
            total = [_mm256_add_epi32(a, c), _mm256_add_epi32(b, d)];
        }
        *joined = transmute!(total);
    }
    joined
}

/// [`AddPairs::add_strip`] with `SETS` sums for every column, so that additions need not wait for each other.
#[inline]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
fn add_strip_avx512<const COUNT: usize, const SETS: usize>(
    rows: &[[Row; PAIRS]],
    inputs: [&[Inputs]; COUNT],
) -> [[i32; STRIP]; COUNT] {
    let mut sums = [[_mm512_setzero_si512(); SETS]; COUNT];
    for (index, rows) in rows.iter().enumerate() {
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            // Inputs do not end before the rows; zeros that stand for them need no way out of the loop.
            let inputs = inputs.get(index).unwrap_or(&[[0; 2]; PAIRS]);
            let sets = rows.as_chunks::<SETS>().0.iter().zip(inputs.as_chunks::<SETS>().0);
            for (rows, inputs) in sets {
                for ((sum, row), pair) in sums.iter_mut().zip(rows).zip(inputs) {
                    *sum = add_row_avx512(*sum, row, *pair);
                }
            }
        }
    }
    // Closures would stay calls: what maps arrays is not built for these instructions.
    let mut joined = [[0; STRIP]; COUNT];
    for (joined, sums) in joined.iter_mut().zip(sums) {
        let mut total = _mm512_setzero_si512();
        for set in sums {
            total = _mm512_add_epi32(total, set);
        }
        *joined = transmute!(total);
    }
    joined
}

/// A bit for each pair that is not zero.
#[inline]
#[target_feature(enable = "avx2")]
fn not_zero_avx2(pairs: &[Pair; STRIP]) -> u16 {
    let halves: [__m256i; 2] = transmute!(*pairs);
    let zeros = |half: __m256i| {
        let zeros = _mm256_cmpeq_epi32(half, _mm256_setzero_si256());
        _mm256_movemask_ps(_mm256_castsi256_ps(zeros)) as u16
    };
    let [low, high] = halves;
    !(zeros(low) | zeros(high) << 8)
}

/// A bit for each pair that is not zero.
#[inline]
#[target_feature(enable = "avx512f")]
fn not_zero_avx512(pairs: &[Pair; STRIP]) -> u16 {
    let pairs: __m512i = transmute!(*pairs);
    _mm512_test_epi32_mask(pairs, pairs)
}

/// [`AddPairs::add_marked`].
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn add_marked_avx2<const COUNT: usize>(
    strips: Strips<'_>,
    inputs: &[Pair],
) -> [[i32; STRIP]; COUNT] {
    let mut sums = [[_mm256_setzero_si256(); 2]; COUNT];
    let not_zero = |pairs: &[Pair; STRIP]| not_zero_avx2(pairs);
    strips.for_each::<COUNT>(inputs, not_zero, |rows, pair| {
        for (sum, row) in sums.iter_mut().zip(rows) {
            *sum = add_row_avx2(*sum, row, pair);
        }
    });
    let mut joined = [[0; STRIP]; COUNT];
    for (joined, sum) in joined.iter_mut().zip(sums) {
        *joined = transmute!(sum);
    }
    joined
}

/// [`AddPairs::add_marked`].
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512vnni")]
fn add_marked_avx512<const COUNT: usize>(
    strips: Strips<'_>,
    inputs: &[Pair],
) -> [[i32; STRIP]; COUNT] {
    let mut sums = [_mm512_setzero_si512(); COUNT];
    let not_zero = |pairs: &[Pair; STRIP]| not_zero_avx512(pairs);
    strips.for_each::<COUNT>(inputs, not_zero, |rows, pair| {
        for (sum, row) in sums.iter_mut().zip(rows) {
            *sum = add_row_avx512(*sum, row, pair);
        }
    });
    let mut joined = [[0; STRIP]; COUNT];
    for (joined, sum) in joined.iter_mut().zip(sums) {
        *joined = transmute!(sum);
    }
    joined
}

// SAFETY (all calls): a value of this type exists only where the processor has the features, which is the one
// obligation of calling a function that is built with them.
#[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
impl<A> AddPairs for Avx2<A> {
    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        // Sixteen registers hold the sums of six vectors once, of one vector four times.
        if COUNT == 1 {
            unsafe { add_strip_avx2::<COUNT, PAIRS>(rows, inputs) }
        } else {
            unsafe { add_strip_avx2::<COUNT, 1>(rows, inputs) }
        }
    }

    #[inline(always)]
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: &[Pair],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { add_marked_avx2(strips, inputs) }
    }
}

// SAFETY: as above.
#[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
impl<A> AddPairs for Avx512<A> {
    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { add_strip_avx512::<COUNT, PAIRS>(rows, inputs) }
    }

    #[inline(always)]
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: &[Pair],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { add_marked_avx512(strips, inputs) }
    }
}

/// Builds the int8 kernels for an instruction set.
macro_rules! build {
    ($name:ident, $module:ident, $features:literal) => {
        // SAFETY: as above.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<A> Int8Kernels for $name<A> {
            #[inline]
            fn quantise(self, values: &[f32], least: f32, integers: &mut [i16]) -> Option<Scale> {
                unsafe { $module::quantise(values, least, integers) }
            }

            #[inline]
            fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
                unsafe { $module::products(self, matrix, vectors) }
            }

            #[inline]
            fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: Vector<'_>) {
                unsafe { $module::sparse_product(self, matrix, vector) }
            }
        }

        mod $module {
            use super::*;

            #[target_feature(enable = $features)]
            pub(super) fn quantise(
                values: &[f32],
                least: f32,
                integers: &mut [i16],
            ) -> Option<Scale> {
                super::quantise(values, least, integers)
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
                vector: Vector<'_>,
            ) {
                super::sparse_product(kernels, matrix, vector);
            }
        }
    };
}

build! { Avx2, avx2, "avx2,fma,bmi1,bmi2,lzcnt,popcnt" }

build! {
    Avx512, avx512,
    "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vnni"
}
