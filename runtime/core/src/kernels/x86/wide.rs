//! What is written by hand for AVX2: vectors of eight floats.

use core::arch::x86_64::{
    __m128, __m256, _CMP_NEQ_UQ, _CMP_UNORD_Q, _mm_add_ps, _mm_cvtss_f32, _mm_max_ps, _mm_max_ss,
    _mm_movehdup_ps, _mm_movehl_ps, _mm256_add_ps, _mm256_castps256_ps128, _mm256_cmp_ps,
    _mm256_extractf128_ps, _mm256_fmadd_ps, _mm256_hadd_ps, _mm256_loadu_ps, _mm256_max_ps,
    _mm256_movemask_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_setzero_ps,
};

use zerocopy::transmute;

use super::{StripRows, runs, sparse};
use crate::kernels::arithmetic::Arithmetic;
use crate::kernels::dot::ROWS;
use crate::kernels::mark::{LANES, Marks};
use crate::kernels::patches::Runs;
use crate::kernels::several::{PART, Strip};

/// Vectors of a part.
const VECTORS: usize = PART / LANES;

/// See [`crate::kernels::mark::mark`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn mark(values: &[f32], marks: &mut [Marks]) -> bool {
    let zero = _mm256_setzero_ps();
    let not_zero = |lanes| {
        let bits = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NEQ_UQ>(lanes, zero));
        u64::from(bits as u32)
    };
    // Stay zeros while all values are finite numbers: zero times any other is none.
    let mut zeros = zero;
    for (values, marks) in values.chunks(MARKED).zip(marks) {
        let mut bits = 0;
        let (chunks, rest) = values.as_chunks();
        for (lanes, first) in chunks.iter().zip((0..).step_by(LANES)) {
            let lanes = load(lanes);
            bits |= not_zero(lanes) << first;
            zeros = _mm256_fmadd_ps(lanes, zero, zeros);
        }
        if !rest.is_empty() {
            let mut few = [0.0; LANES];
            let (lanes, first) = match values.last_chunk() {
                // Comparing some of them once more changes nothing.
                Some(lanes) => (lanes, values.len() - LANES),
                None => {
                    for (lane, value) in few.iter_mut().zip(rest) {
                        *lane = *value;
                    }
                    (&few, 0)
                }
            };
            let lanes = load(lanes);
            bits |= not_zero(lanes) << first;
            zeros = _mm256_fmadd_ps(lanes, zero, zeros);
        }
        *marks = [bits as u32, (bits >> 32) as u32];
    }
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_UNORD_Q>(zeros, zeros)) == 0
}

/// A bit for each of 64 values, set where it is not zero.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn not_zero(values: &[f32; MARKED]) -> u64 {
    let mut bits = 0;
    for (lanes, first) in values.as_chunks().0.iter().zip((0..).step_by(LANES)) {
        let not_zero = _mm256_cmp_ps::<_CMP_NEQ_UQ>(load(lanes), _mm256_setzero_ps());
        bits |= u64::from(_mm256_movemask_ps(not_zero) as u32) << first;
    }
    bits
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn load(lanes: &[f32; LANES]) -> __m256 {
    transmute!(*lanes)
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn multiply_add<A: Arithmetic>(sum: __m256, a: __m256, b: __m256) -> __m256 {
    if A::FUSED { _mm256_fmadd_ps(a, b, sum) } else { _mm256_add_ps(sum, _mm256_mul_ps(a, b)) }
}

/// Vectors of a row in pairs, and one where their number is odd.
#[inline(always)]
fn pairs_of(values: &[f32]) -> (&[[[f32; LANES]; 2]], &[[f32; LANES]]) {
    values.as_chunks::<LANES>().0.as_chunks()
}

/// The dot products of a vector with four rows: see [`crate::kernels::dot::four_dots`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn four_dots<A: Arithmetic>(vector: &[f32], rows: [&[f32]; ROWS]) -> [f32; ROWS] {
    let (pairs, rest) = pairs_of(vector);
    let [r0, r1, r2, r3] = rows;
    let [r0, r1, r2, r3] = [pairs_of(r0), pairs_of(r1), pairs_of(r2), pairs_of(r3)];
    let mut low = [_mm256_setzero_ps(); ROWS];
    let mut high = low;
    let rows = r0.0.iter().zip(r1.0).zip(r2.0).zip(r3.0);
    for ([low_v, high_v], (((r0, r1), r2), r3)) in pairs.iter().zip(rows) {
        let (low_v, high_v) = (load(low_v), load(high_v));
        let sums = low.iter_mut().zip(&mut high);
        for ((low, high), [low_row, high_row]) in sums.zip([r0, r1, r2, r3]) {
            *low = multiply_add::<A>(*low, low_v, load(low_row));
            *high = multiply_add::<A>(*high, high_v, load(high_row));
        }
    }
    let rows = [r0.1, r1.1, r2.1, r3.1];
    for (low, row) in low.iter_mut().zip(rows) {
        if let (Some(v), Some(row)) = (rest.first(), row.first()) {
            *low = multiply_add::<A>(*low, load(v), load(row));
        }
    }
    join(low, high)
}

/// [`crate::kernels::dot::join`] of four sums at once, whose lower and upper eight lanes come apart.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn join(low: [__m256; ROWS], high: [__m256; ROWS]) -> [f32; ROWS] {
    let [a, b, c, d] = low;
    let [e, f, g, h] = high;
    let [a, b] = [_mm256_add_ps(a, e), _mm256_add_ps(b, f)];
    let [c, d] = [_mm256_add_ps(c, g), _mm256_add_ps(d, h)];
    let neighbours = _mm256_hadd_ps(_mm256_hadd_ps(a, b), _mm256_hadd_ps(c, d));
    let halves = [_mm256_castps256_ps128(neighbours), _mm256_extractf128_ps::<1>(neighbours)];
    let [first, second]: [__m128; 2] = halves;
    transmute!(_mm_add_ps(first, second))
}

/// See [`crate::kernels::softmax::largest`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn largest(lanes: [f32; PART]) -> f32 {
    let [low, high]: [__m256; 2] = transmute!(lanes);
    let eight = _mm256_max_ps(low, high);
    let four = _mm_max_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
    let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
    _mm_cvtss_f32(_mm_max_ss(two, _mm_movehdup_ps(two)))
}

/// Most vectors of inputs whose sums fit into sixteen registers beside weights.
pub(super) const GROUP: usize = 6;

/// See [`crate::kernels::several::AddRows::parts`]: enough sums that none waits for its last addition.
pub(super) const fn parts(count: usize, _: bool) -> usize {
    if count <= 3 { 2 } else { 1 }
}

/// See [`crate::kernels::several::AddRows::add_rows`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn add_rows<A: Arithmetic, const PARTS: usize, const COUNT: usize>(
    strip: Strip<'_>,
    start: [[f32; PART]; PARTS],
    inputs: [&[f32]; COUNT],
) -> [[[f32; PART]; PARTS]; COUNT] {
    let mut first = [[_mm256_setzero_ps(); VECTORS]; PARTS];
    for (vectors, part) in first.iter_mut().zip(start) {
        *vectors = transmute!(part);
    }
    let mut sums = [first; COUNT];
    for (row, inputs) in StripRows::<PARTS, COUNT>::new(strip, inputs) {
        let mut weights = [[_mm256_setzero_ps(); VECTORS]; PARTS];
        for (vectors, part) in weights.iter_mut().zip(row) {
            *vectors = transmute!(*part);
        }
        for (sums, input) in sums.iter_mut().zip(inputs) {
            let input = _mm256_set1_ps(*input);
            for (sum, weight) in sums.as_flattened_mut().iter_mut().zip(weights.as_flattened()) {
                *sum = multiply_add::<A>(*sum, input, *weight);
            }
        }
    }
    let mut results = [start; COUNT];
    for (result, sums) in results.as_flattened_mut().iter_mut().zip(sums.as_flattened()) {
        *result = transmute!(*sums);
    }
    results
}

sparse::sparse_product! {
    /// See [`crate::kernels::product::sparse_product`]; the sums of one tile fit into registers.
    __m256, _mm256_set1_ps, _mm256_loadu_ps, 1, false, "avx2,fma,bmi1,bmi2,lzcnt,popcnt"
}

/// Patches whose sums, two vectors each, fit into sixteen registers beside weights.
pub(super) const PATCHES: usize = 6;

runs::add_runs! {
    /// See [`crate::kernels::patches::AddRuns::add_runs`].
    __m256, VECTORS, _mm256_set1_ps, "avx2,fma,bmi1,bmi2,lzcnt,popcnt"
}
