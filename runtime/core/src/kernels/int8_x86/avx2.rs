//! The int8 kernels for AVX2: eight sums in a vector.

use core::arch::x86_64::{
    __m128i, __m256, __m256i, _mm_add_epi32, _mm_cvtsi128_si32, _mm_max_epu32, _mm_shuffle_epi32,
    _mm256_add_epi32, _mm256_add_ps, _mm256_and_si256, _mm256_castsi256_pd, _mm256_cmpeq_epi64,
    _mm256_cvtepi8_epi16, _mm256_cvtepi32_ps, _mm256_cvtps_epi32, _mm256_madd_epi16,
    _mm256_max_epu32, _mm256_max_ps, _mm256_movemask_pd, _mm256_mul_ps, _mm256_packs_epi32,
    _mm256_permute2x128_si256, _mm256_permute4x64_epi64, _mm256_set1_epi32, _mm256_set1_ps,
    _mm256_setzero_si256, _mm256_unpackhi_epi16, _mm256_unpacklo_epi16,
};

use zerocopy::transmute;

use super::products::products;
use super::{MAGNITUDE, filled};
use crate::kernels::int8::{
    Count, INPUTS, Inputs, IntegerRows, Lanes, Marked, PAIRS, Pair, Row, STRIP, Scale, Strips,
};
use crate::kernels::patches::Runs;

/// Sums of a strip, eight columns in each vector.
type Sums = [__m256i; 2];
/// A row of weights as int16.
type Weights = [__m256i; 2];

products! { "avx2,bmi1,bmi2,lzcnt,popcnt" }

#[inline]
#[target_feature(enable = "avx2")]
fn zero() -> Sums {
    [_mm256_setzero_si256(); 2]
}

#[inline]
#[target_feature(enable = "avx2")]
fn widened(row: &Row) -> Weights {
    let [low, high]: [__m128i; 2] = transmute!(*row);
    [_mm256_cvtepi8_epi16(low), _mm256_cvtepi8_epi16(high)]
}

#[inline]
#[target_feature(enable = "avx2")]
fn add_widened([a, b]: Sums, [low, high]: Weights, pair: i32) -> Sums {
    let inputs = _mm256_set1_epi32(pair);
    let (low, high) = (_mm256_madd_epi16(low, inputs), _mm256_madd_epi16(high, inputs));
    [_mm256_add_epi32(a, low), _mm256_add_epi32(b, high)]
}

#[inline]
#[target_feature(enable = "avx2")]
fn add_sums([a, b]: Sums, [c, d]: Sums) -> Sums {
    [_mm256_add_epi32(a, c), _mm256_add_epi32(b, d)]
}

/// Patches whose sums, two vectors each, fit into sixteen registers beside weights.
pub(super) const PATCHES: usize = 6;

/// [`crate::kernels::int8::Lanes::add_two_strips`].
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn add_two_strips(rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
    let [first, second] = rows;
    let mut sums = [[[_mm256_setzero_si256(); 2]; 2]; 2];
    for ((first, second), inputs) in first.iter().zip(second).zip(inputs) {
        let rows = first.iter().zip(second).zip(inputs);
        for (index, ((first, second), pair)) in rows.enumerate() {
            let Some([low, high]) = sums.get_mut(index % 2) else { continue };
            *low = add_row(*low, first, *pair);
            *high = add_row(*high, second, *pair);
        }
    }
    let [[low, high], [more_low, more_high]] = sums;
    let add = |[a, b]: Sums, [c, d]: Sums| -> [i32; STRIP] {
        transmute!([_mm256_add_epi32(a, c), _mm256_add_epi32(b, d)])
    };
    [add(low, more_low), add(high, more_high)]
}

/// A bit for each pair of values that is not zero.
#[inline]
#[target_feature(enable = "avx2")]
fn not_zero(values: &[f32; STRIP]) -> u8 {
    let [low, high]: [__m256i; 2] = transmute!(*values);
    let magnitude = _mm256_set1_epi32(MAGNITUDE);
    let zero = _mm256_setzero_si256();
    let low = _mm256_cmpeq_epi64(_mm256_and_si256(low, magnitude), zero);
    let high = _mm256_cmpeq_epi64(_mm256_and_si256(high, magnitude), zero);
    let low = _mm256_movemask_pd(_mm256_castsi256_pd(low)) as u8;
    let high = _mm256_movemask_pd(_mm256_castsi256_pd(high)) as u8;
    !(low | high << 4)
}

/// [`crate::kernels::int8::Lanes::largest_magnitude`].
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn largest_magnitude(values: &[f32]) -> u32 {
    let mut largest = [_mm256_setzero_si256(); 2];
    let compare = |largest: __m256i, lanes: __m256i| {
        let magnitudes = _mm256_and_si256(lanes, _mm256_set1_epi32(MAGNITUDE));
        _mm256_max_epu32(largest, magnitudes)
    };
    let compare = |[a, b]: Sums, values: &[f32; STRIP]| -> Sums {
        let [low, high]: [__m256i; 2] = transmute!(*values);
        [compare(a, low), compare(b, high)]
    };
    let (chunks, rest) = values.as_chunks();
    for chunk in chunks {
        largest = compare(largest, chunk);
    }
    if !rest.is_empty() {
        // Comparing some of them once more changes nothing.
        largest = match values.last_chunk() {
            Some(chunk) => compare(largest, chunk),
            None => compare(largest, &filled(rest)),
        };
    }
    let [low, high] = largest;
    let halves: [__m128i; 2] = transmute!(_mm256_max_epu32(low, high));
    let [low, high] = halves;
    let four: [u32; 4] = transmute!(_mm_max_epu32(low, high));
    let [a, b, c, d] = four;
    a.max(b).max(c.max(d))
}

/// [`crate::kernels::int8::Lanes::integers`].
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn integers(scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
    let halves: [__m256; 2] = transmute!(*values);
    let factor = _mm256_set1_ps(scale.factor);
    // Rounds to the nearest, ties to even, as adding a constant does.
    let integers = |half: __m256| _mm256_cvtps_epi32(_mm256_mul_ps(half, factor));
    let [low, high] = halves;
    // Packing works in halves of the vector, whose quarters then stand in the order 0, 2, 1, 3.
    let packed = _mm256_packs_epi32(integers(low), integers(high));
    transmute!(_mm256_permute4x64_epi64::<0b11_01_10_00>(packed))
}

/// [`crate::kernels::int8::Lanes::numbers`].
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn numbers(sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
    let (sums, steps, bias): ([__m256i; 2], [__m256; 2], [__m256; 2]) =
        (transmute!(*sums), transmute!(*count.steps), transmute!(*count.bias));
    let number = |sum: __m256i, step: __m256, bias: __m256| {
        let step = _mm256_mul_ps(_mm256_set1_ps(count.step), step);
        let number = _mm256_add_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(sum), step), bias);
        // The second operand is the result where it is no number.
        _mm256_max_ps(_mm256_set1_ps(count.least()), number)
    };
    let ([s0, s1], [t0, t1], [b0, b1]) = (sums, steps, bias);
    transmute!([number(s0, t0, b0), number(s1, t1, b1)])
}

/// The dot product of two vectors of whole [`INPUTS`].
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn dot(vector: &[i16], row: &[i16]) -> i32 {
    let mut sums = [_mm256_setzero_si256(); 2];
    let chunks = vector.as_chunks::<INPUTS>().0.iter().zip(row.as_chunks::<INPUTS>().0);
    for (a, b) in chunks {
        let (a, b): ([__m256i; 2], [__m256i; 2]) = (transmute!(*a), transmute!(*b));
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(a, b));
        }
    }
    let [even, odd] = sums;
    let halves: [__m128i; 2] = transmute!(_mm256_add_epi32(even, odd));
    let [low, high] = halves;
    let four = _mm_add_epi32(low, high);
    let two = _mm_add_epi32(four, _mm_shuffle_epi32::<0b11_10_11_10>(four));
    _mm_cvtsi128_si32(_mm_add_epi32(two, _mm_shuffle_epi32::<0b01>(two)))
}

/// The weighted sums of rows, in columns of whole strips: two rows at a time, whose columns are multiplied as pairs.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn mix(weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
    let (fours, rest) = sums.as_chunks_mut::<STRIP>().0.as_chunks_mut::<4>();
    for (four, sums) in fours.iter_mut().enumerate() {
        mix_strips(weights, rows, 4 * four, sums);
    }
    for (strip, sums) in (4 * fours.len()..).zip(rest) {
        mix_strips(weights, rows, strip, core::array::from_mut(sums));
    }
}

/// Strips of the sums, from a first one on.
#[inline]
#[target_feature(enable = "avx2")]
fn mix_strips<const COUNT: usize>(
    weights: &[i16],
    rows: IntegerRows<'_>,
    first: usize,
    sums: &mut [[i32; STRIP]; COUNT],
) {
    let mut halves = [[_mm256_setzero_si256(); 2]; COUNT];
    for (slots, pair) in rows.slots.chunks(2).zip(weights.as_chunks::<2>().0) {
        let Some([first, second]) = rows.two::<STRIP, COUNT>(slots, first) else { continue };
        let pair = _mm256_set1_epi32(transmute!(*pair));
        for ([low, high], (first, second)) in halves.iter_mut().zip(first.iter().zip(second)) {
            let (first, second) = (transmute!(*first), transmute!(*second));
            let even = _mm256_madd_epi16(_mm256_unpacklo_epi16(first, second), pair);
            let odd = _mm256_madd_epi16(_mm256_unpackhi_epi16(first, second), pair);
            *low = _mm256_add_epi32(*low, even);
            *high = _mm256_add_epi32(*high, odd);
        }
    }
    // Unpacking works in halves of the vector: quarters stand in the order 0, 2 and 1, 3.
    for (sums, [low, high]) in sums.iter_mut().zip(halves) {
        let first = _mm256_permute2x128_si256::<0x20>(low, high);
        let second = _mm256_permute2x128_si256::<0x31>(low, high);
        *sums = transmute!([first, second]);
    }
}
