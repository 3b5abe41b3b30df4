//! The int8 kernels for AVX2, and for AVX-512 with its instruction for integer networks (VNNI).
//!
//! Both multiply pairs of int16 and add the two products in i32; bytes of weights are widened on the way. What is
//! written with intrinsics is this alone: all else is the portable code, compiled once more.

use core::arch::x86_64::{
    __m128i, __m256, __m256i, __m512i, _mm_max_epu32, _mm256_add_epi32, _mm256_add_ps,
    _mm256_and_si256, _mm256_castps_si256, _mm256_castsi256_ps, _mm256_cmpeq_epi32,
    _mm256_cvtepi8_epi16, _mm256_cvtepi32_ps, _mm256_madd_epi16, _mm256_max_epu32, _mm256_max_ps,
    _mm256_movemask_ps, _mm256_mul_ps, _mm256_packs_epi32, _mm256_permute4x64_epi64,
    _mm256_set1_epi32, _mm256_set1_ps, _mm256_setzero_ps, _mm256_setzero_si256, _mm256_slli_epi32,
    _mm256_srai_epi32, _mm512_add_epi32, _mm512_add_ps, _mm512_and_si512, _mm512_castps_si512,
    _mm512_cvtepi8_epi16, _mm512_cvtepi32_epi16, _mm512_cvtepi32_ps, _mm512_dpwssd_epi32,
    _mm512_max_epu32, _mm512_max_ps, _mm512_mul_ps, _mm512_reduce_max_epu32, _mm512_set1_epi32,
    _mm512_set1_ps, _mm512_setzero_ps, _mm512_setzero_si512, _mm512_test_epi32_mask,
};

use zerocopy::transmute;

use super::int8::{
    Count, Inputs, Int8Kernels, Lanes, Matrix, PAIRS, Pair, ROUND, Row, STRIP, Scale, Strips,
    Vector, products, quantise, sparse_product,
};
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

/// [`Lanes::add_strip`] with `SETS` sums for every column, so that additions need not wait for each other.
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

/// [`Lanes::add_strip`] with `SETS` sums for every column, so that additions need not wait for each other.
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

/// [`Lanes::add_two_strips`].
#[inline]
#[target_feature(enable = "avx2")]
fn add_two_strips_avx2(rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
    let [first, second] = rows;
    let mut sums = [[[_mm256_setzero_si256(); 2]; 2]; 2];
    for ((first, second), inputs) in first.iter().zip(second).zip(inputs) {
        let rows = first.iter().zip(second).zip(inputs);
        for (index, ((first, second), pair)) in rows.enumerate() {
            let Some([low, high]) = sums.get_mut(index % 2) else { continue };
            *low = add_row_avx2(*low, first, *pair);
            *high = add_row_avx2(*high, second, *pair);
        }
    }
    let [[low, high], [more_low, more_high]] = sums;
    let add = |[a, b]: Sums256, [c, d]: Sums256| -> [i32; STRIP] {
        transmute!([_mm256_add_epi32(a, c), _mm256_add_epi32(b, d)])
    };
    [add(low, more_low), add(high, more_high)]
}

/// [`Lanes::add_two_strips`].
#[inline]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
fn add_two_strips_avx512(rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
    let [first, second] = rows;
    let mut sums = [[_mm512_setzero_si512(); 2]; PAIRS];
    for ((first, second), inputs) in first.iter().zip(second).zip(inputs) {
        let rows = first.iter().zip(second).zip(inputs);
        for (index, ((first, second), pair)) in rows.enumerate() {
            let Some([low, high]) = sums.get_mut(index % PAIRS) else { continue };
            *low = add_row_avx512(*low, first, *pair);
            *high = add_row_avx512(*high, second, *pair);
        }
    }
    let add = |strip: [__m512i; PAIRS]| -> [i32; STRIP] {
        let [a, b, c, d] = strip;
        transmute!(_mm512_add_epi32(_mm512_add_epi32(a, b), _mm512_add_epi32(c, d)))
    };
    let [[a, e], [b, f], [c, g], [d, h]] = sums;
    [add([a, b, c, d]), add([e, f, g, h])]
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

/// [`Lanes::add_marked`].
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

/// [`Lanes::add_marked`].
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

/// The bits of a number without its sign.
const MAGNITUDE: i32 = 0x7fff_ffff;

/// [`Lanes::largest_magnitude`].
#[inline]
#[target_feature(enable = "avx2")]
fn largest_magnitude_avx2(values: &[f32]) -> u32 {
    let mut largest = _mm256_setzero_si256();
    let compare = |largest: __m256i, lanes: &[f32; 8]| {
        let magnitudes = _mm256_and_si256(transmute!(*lanes), _mm256_set1_epi32(MAGNITUDE));
        _mm256_max_epu32(largest, magnitudes)
    };
    let (chunks, rest) = values.as_chunks();
    for lanes in chunks {
        largest = compare(largest, lanes);
    }
    // Comparing some of them once more changes nothing.
    let rest = values.last_chunk().map_or_else(|| filled(rest), |lanes| *lanes);
    largest = compare(largest, &rest);
    let halves: [__m128i; 2] = transmute!(largest);
    let [low, high] = halves;
    let four: [u32; 4] = transmute!(_mm_max_epu32(low, high));
    let [a, b, c, d] = four;
    a.max(b).max(c.max(d))
}

/// [`Lanes::largest_magnitude`].
#[inline]
#[target_feature(enable = "avx512f")]
fn largest_magnitude_avx512(values: &[f32]) -> u32 {
    let mut largest = _mm512_setzero_si512();
    let compare = |largest: __m512i, lanes: &[f32; STRIP]| {
        let magnitudes = _mm512_and_si512(transmute!(*lanes), _mm512_set1_epi32(MAGNITUDE));
        _mm512_max_epu32(largest, magnitudes)
    };
    let (chunks, rest) = values.as_chunks();
    for lanes in chunks {
        largest = compare(largest, lanes);
    }
    // Comparing some of them once more changes nothing.
    let rest = values.last_chunk().map_or_else(|| filled(rest), |lanes| *lanes);
    largest = compare(largest, &rest);
    _mm512_reduce_max_epu32(largest)
}

/// Values with zeros behind them.
fn filled<const LANES: usize>(values: &[f32]) -> [f32; LANES] {
    let mut lanes = [0.0; LANES];
    for (lane, value) in lanes.iter_mut().zip(values) {
        *lane = *value;
    }
    lanes
}

/// [`Lanes::integers`].
#[inline]
#[target_feature(enable = "avx2")]
fn integers_avx2(scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
    let halves: [__m256; 2] = transmute!(*values);
    let (factor, round) = (_mm256_set1_ps(scale.factor), _mm256_set1_ps(ROUND));
    let integers = |half: __m256| {
        let bits = _mm256_castps_si256(_mm256_add_ps(_mm256_mul_ps(half, factor), round));
        _mm256_srai_epi32::<16>(_mm256_slli_epi32::<16>(bits))
    };
    let [low, high] = halves;
    // Packing works in halves of the vector, whose quarters then stand in the order 0, 2, 1, 3.
    let packed = _mm256_packs_epi32(integers(low), integers(high));
    transmute!(_mm256_permute4x64_epi64::<0b11_01_10_00>(packed))
}

/// [`Lanes::integers`].
#[inline]
#[target_feature(enable = "avx512f")]
fn integers_avx512(scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
    let scaled = _mm512_mul_ps(transmute!(*values), _mm512_set1_ps(scale.factor));
    let rounded = _mm512_add_ps(scaled, _mm512_set1_ps(ROUND));
    transmute!(_mm512_cvtepi32_epi16(_mm512_castps_si512(rounded)))
}

/// [`Lanes::numbers`].
#[inline]
#[target_feature(enable = "avx2")]
fn numbers_avx2(sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
    let (sums, steps, bias): ([__m256i; 2], [__m256; 2], [__m256; 2]) =
        (transmute!(*sums), transmute!(*count.steps), transmute!(*count.bias));
    let number = |sum: __m256i, step: __m256, bias: __m256| {
        let step = _mm256_mul_ps(_mm256_set1_ps(count.step), step);
        let number = _mm256_add_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(sum), step), bias);
        // The second operand is the result where it is no number.
        if count.relu { _mm256_max_ps(_mm256_setzero_ps(), number) } else { number }
    };
    let ([s0, s1], [t0, t1], [b0, b1]) = (sums, steps, bias);
    transmute!([number(s0, t0, b0), number(s1, t1, b1)])
}

/// [`Lanes::numbers`].
#[inline]
#[target_feature(enable = "avx512f")]
fn numbers_avx512(sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
    let step = _mm512_mul_ps(_mm512_set1_ps(count.step), transmute!(*count.steps));
    let sums = _mm512_mul_ps(_mm512_cvtepi32_ps(transmute!(*sums)), step);
    let numbers = _mm512_add_ps(sums, transmute!(*count.bias));
    // The second operand is the result where it is no number.
    transmute!(if count.relu { _mm512_max_ps(_mm512_setzero_ps(), numbers) } else { numbers })
}

// SAFETY (all calls): a value of this type exists only where the processor has the features, which is the one
// obligation of calling a function that is built with them.
#[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
impl<A> Lanes for Avx2<A> {
    #[inline(always)]
    fn largest_magnitude(self, values: &[f32]) -> u32 {
        unsafe { largest_magnitude_avx2(values) }
    }

    #[inline(always)]
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
        unsafe { integers_avx2(scale, values) }
    }

    #[inline(always)]
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        unsafe { numbers_avx2(sums, count) }
    }

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
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
        unsafe { add_two_strips_avx2(rows, inputs) }
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
impl<A> Lanes for Avx512<A> {
    #[inline(always)]
    fn largest_magnitude(self, values: &[f32]) -> u32 {
        unsafe { largest_magnitude_avx512(values) }
    }

    #[inline(always)]
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
        unsafe { integers_avx512(scale, values) }
    }

    #[inline(always)]
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        unsafe { numbers_avx512(sums, count) }
    }

    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        unsafe { add_strip_avx512::<COUNT, PAIRS>(rows, inputs) }
    }

    #[inline(always)]
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
        unsafe { add_two_strips_avx512(rows, inputs) }
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
                unsafe { $module::quantise(self, values, least, integers) }
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
            pub(super) fn quantise<A>(
                kernels: $name<A>,
                values: &[f32],
                least: f32,
                integers: &mut [i16],
            ) -> Option<Scale> {
                super::quantise(kernels, values, least, integers)
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
