//! The int8 kernels for AVX-512 with its instruction for integer networks (VNNI): sixteen sums in a vector.

use core::arch::x86_64::{
    __m256i, __m512i, _mm512_add_epi32, _mm512_add_ps, _mm512_and_si512, _mm512_castps_si512,
    _mm512_cvtepi8_epi16, _mm512_cvtepi32_epi16, _mm512_cvtepi32_ps, _mm512_dpwssd_epi32,
    _mm512_max_epu32, _mm512_max_ps, _mm512_mul_ps, _mm512_permutex2var_epi64,
    _mm512_reduce_add_epi32, _mm512_reduce_max_epu32, _mm512_set1_epi32, _mm512_set1_ps,
    _mm512_setzero_si512, _mm512_test_epi64_mask, _mm512_unpackhi_epi16, _mm512_unpacklo_epi16,
};

use zerocopy::transmute;

use super::products::products;
use super::{MAGNITUDE, filled};
use crate::kernels::int8::{
    Count, INPUTS, Inputs, IntegerRows, Lanes, Marked, PAIRS, Pair, ROUND, Row, STRIP, Scale,
    Strips,
};
use crate::kernels::patches::Runs;

/// Sums of a strip.
type Sums = __m512i;
/// A row of weights as int16.
type Weights = __m512i;

products! { "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512vnni" }

#[inline]
#[target_feature(enable = "avx512f")]
fn zero() -> Sums {
    _mm512_setzero_si512()
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn widened(row: &Row) -> Weights {
    let row: __m256i = transmute!(*row);
    _mm512_cvtepi8_epi16(row)
}

#[inline]
#[target_feature(enable = "avx512f,avx512vnni")]
fn add_widened(sums: Sums, weights: Weights, pair: i32) -> Sums {
    _mm512_dpwssd_epi32(sums, weights, _mm512_set1_epi32(pair))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn add_sums(left: Sums, right: Sums) -> Sums {
    _mm512_add_epi32(left, right)
}

/// Patches whose sums fit into registers; their starts are as many as there are general registers.
pub(super) const PATCHES: usize = 14;

/// [`crate::kernels::int8::Lanes::add_two_strips`].
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512vnni")]
pub(super) fn add_two_strips(rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
    let [first, second] = rows;
    let mut sums = [[_mm512_setzero_si512(); 2]; PAIRS];
    for ((first, second), inputs) in first.iter().zip(second).zip(inputs) {
        let rows = first.iter().zip(second).zip(inputs);
        for (index, ((first, second), pair)) in rows.enumerate() {
            let Some([low, high]) = sums.get_mut(index % PAIRS) else { continue };
            *low = add_row(*low, first, *pair);
            *high = add_row(*high, second, *pair);
        }
    }
    let add = |strip: [__m512i; PAIRS]| -> [i32; STRIP] {
        let [a, b, c, d] = strip;
        transmute!(_mm512_add_epi32(_mm512_add_epi32(a, b), _mm512_add_epi32(c, d)))
    };
    let [[a, e], [b, f], [c, g], [d, h]] = sums;
    [add([a, b, c, d]), add([e, f, g, h])]
}

/// A bit for each pair of values that is not zero.
#[inline]
#[target_feature(enable = "avx512f")]
fn not_zero(values: &[f32; STRIP]) -> u8 {
    let values: __m512i = transmute!(*values);
    _mm512_test_epi64_mask(values, _mm512_set1_epi32(MAGNITUDE))
}

/// [`crate::kernels::int8::Lanes::largest_magnitude`].
#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn largest_magnitude(values: &[f32]) -> u32 {
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
    match values.last_chunk() {
        Some(lanes) => largest = compare(largest, lanes),
        None => largest = compare(largest, &filled(rest)),
    }
    _mm512_reduce_max_epu32(largest)
}

/// [`crate::kernels::int8::Lanes::integers`].
#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn integers(scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
    let scaled = _mm512_mul_ps(transmute!(*values), _mm512_set1_ps(scale.factor));
    let rounded = _mm512_add_ps(scaled, _mm512_set1_ps(ROUND));
    transmute!(_mm512_cvtepi32_epi16(_mm512_castps_si512(rounded)))
}

/// [`crate::kernels::int8::Lanes::numbers`].
#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn numbers(sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
    let step = _mm512_mul_ps(_mm512_set1_ps(count.step), transmute!(*count.steps));
    let sums = _mm512_mul_ps(_mm512_cvtepi32_ps(transmute!(*sums)), step);
    let numbers = _mm512_add_ps(sums, transmute!(*count.bias));
    // The second operand is the result where it is no number.
    transmute!(_mm512_max_ps(_mm512_set1_ps(count.least()), numbers))
}

/// The dot product of two vectors of whole [`INPUTS`].
#[inline]
#[target_feature(enable = "avx512f,avx512vnni")]
pub(super) fn dot(vector: &[i16], row: &[i16]) -> i32 {
    let mut sums = _mm512_setzero_si512();
    let chunks = vector.as_chunks::<INPUTS>().0.iter().zip(row.as_chunks::<INPUTS>().0);
    for (a, b) in chunks {
        sums = _mm512_dpwssd_epi32(sums, transmute!(*a), transmute!(*b));
    }
    _mm512_reduce_add_epi32(sums)
}

/// Which eighths of two vectors of unpacked columns are those of the first sixteen columns, and of the others.
const FIRST: [u64; 8] = [0, 1, 8, 9, 2, 3, 10, 11];
const SECOND: [u64; 8] = [4, 5, 12, 13, 6, 7, 14, 15];

/// The weighted sums of rows, in columns of whole [`INPUTS`]: two rows at a time, whose columns are multiplied as pairs.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn mix(weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
    let (fours, rest) = sums.as_chunks_mut::<INPUTS>().0.as_chunks_mut::<4>();
    for (four, sums) in fours.iter_mut().enumerate() {
        mix_parts(weights, rows, 4 * four, sums);
    }
    for (part, sums) in (4 * fours.len()..).zip(rest) {
        mix_parts(weights, rows, part, core::array::from_mut(sums));
    }
}

/// Parts of the sums, from a first one on.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn mix_parts<const COUNT: usize>(
    weights: &[i16],
    rows: IntegerRows<'_>,
    first: usize,
    sums: &mut [[i32; INPUTS]; COUNT],
) {
    let mut halves = [[_mm512_setzero_si512(); 2]; COUNT];
    for (slots, pair) in rows.slots.chunks(2).zip(weights.as_chunks::<2>().0) {
        let Some([first, second]) = rows.two::<INPUTS, COUNT>(slots, first) else { continue };
        let pair = _mm512_set1_epi32(transmute!(*pair));
        for ([low, high], (first, second)) in halves.iter_mut().zip(first.iter().zip(second)) {
            let (first, second) = (transmute!(*first), transmute!(*second));
            *low = _mm512_dpwssd_epi32(*low, _mm512_unpacklo_epi16(first, second), pair);
            *high = _mm512_dpwssd_epi32(*high, _mm512_unpackhi_epi16(first, second), pair);
        }
    }
    // Unpacking works in quarters of the vector.
    for (sums, [low, high]) in sums.iter_mut().zip(halves) {
        let first = _mm512_permutex2var_epi64(low, transmute!(FIRST), high);
        let second = _mm512_permutex2var_epi64(low, transmute!(SECOND), high);
        *sums = transmute!([first, second]);
    }
}
