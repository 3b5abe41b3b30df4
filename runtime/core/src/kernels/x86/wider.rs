//! What is written by hand for AVX-512: vectors of sixteen floats.

use core::arch::x86_64::{
    __m512, _CMP_NEQ_UQ, _mm512_add_ps, _mm512_castps512_ps256, _mm512_cmp_ps_mask,
    _mm512_extractf32x8_ps, _mm512_fmadd_ps, _mm512_fpclass_ps_mask, _mm512_loadu_ps,
    _mm512_maskz_loadu_ps, _mm512_mul_ps, _mm512_reduce_max_ps, _mm512_set1_ps, _mm512_setzero_ps,
};

use zerocopy::transmute;

use super::{StripRows, runs, sparse, wide};
use crate::kernels::arithmetic::Arithmetic;
use crate::kernels::dot::{LANES, ROWS};
use crate::kernels::mark::Marks;
use crate::kernels::patches::Runs;
use crate::kernels::several::{PART, Strip};

/// Classes of numbers: either NaN, either infinity.
pub(super) const NOT_FINITE: i32 = 0x01 | 0x08 | 0x10 | 0x80;

/// See [`crate::kernels::mark::mark`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn mark(values: &[f32], marks: &mut [Marks]) -> bool {
    let mut not_finite = 0;
    for (values, marks) in values.chunks(MARKED).zip(marks) {
        let mut bits = 0;
        for (lanes, first) in values.chunks(LANES).zip((0..).step_by(LANES)) {
            let some = u16::MAX >> (LANES - lanes.len());
            // SAFETY: lanes behind the last value are not read.
            #[allow(unsafe_code)]
            let lanes = unsafe { _mm512_maskz_loadu_ps(some, lanes.as_ptr()) };
            let not_zero = _mm512_cmp_ps_mask::<_CMP_NEQ_UQ>(lanes, _mm512_setzero_ps());
            bits |= u64::from(not_zero) << first;
            not_finite |= _mm512_fpclass_ps_mask::<{ NOT_FINITE }>(lanes);
        }
        *marks = [bits as u32, (bits >> 32) as u32];
    }
    not_finite == 0
}

/// A bit for each of 64 values, set where it is not zero.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn not_zero(values: &[f32; MARKED]) -> u64 {
    let mut bits = 0;
    for (lanes, first) in lanes_of(values).iter().zip((0..).step_by(LANES)) {
        let not_zero = _mm512_cmp_ps_mask::<_CMP_NEQ_UQ>(load(lanes), _mm512_setzero_ps());
        bits |= u64::from(not_zero) << first;
    }
    bits
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn load(lanes: &[f32; LANES]) -> __m512 {
    transmute!(*lanes)
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn multiply_add<A: Arithmetic>(sum: __m512, a: __m512, b: __m512) -> __m512 {
    if A::FUSED { _mm512_fmadd_ps(a, b, sum) } else { _mm512_add_ps(sum, _mm512_mul_ps(a, b)) }
}

#[inline(always)]
pub(super) fn lanes_of(values: &[f32]) -> &[[f32; LANES]] {
    values.as_chunks().0
}

/// The dot products of a vector with four rows: see [`crate::kernels::dot::four_dots`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn four_dots<A: Arithmetic>(vector: &[f32], rows: [&[f32]; ROWS]) -> [f32; ROWS] {
    if !vector.len().is_multiple_of(LANES) {
        return wide::four_dots::<A>(vector, rows);
    }
    let [r0, r1, r2, r3] = rows;
    let [r0, r1, r2, r3] = [lanes_of(r0), lanes_of(r1), lanes_of(r2), lanes_of(r3)];
    let mut sums = [_mm512_setzero_ps(); ROWS];
    for (lanes, (((r0, r1), r2), r3)) in
        lanes_of(vector).iter().zip(r0.iter().zip(r1).zip(r2).zip(r3))
    {
        let vector = load(lanes);
        for (sum, row) in sums.iter_mut().zip([r0, r1, r2, r3]) {
            *sum = multiply_add::<A>(*sum, vector, load(row));
        }
    }
    join(sums)
}

/// [`crate::kernels::dot::join`] of four sums at once.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn join(sums: [__m512; ROWS]) -> [f32; ROWS] {
    let [a, b, c, d] = sums;
    let low = [
        _mm512_castps512_ps256(a),
        _mm512_castps512_ps256(b),
        _mm512_castps512_ps256(c),
        _mm512_castps512_ps256(d),
    ];
    let high = [
        _mm512_extractf32x8_ps::<1>(a),
        _mm512_extractf32x8_ps::<1>(b),
        _mm512_extractf32x8_ps::<1>(c),
        _mm512_extractf32x8_ps::<1>(d),
    ];
    wide::join(low, high)
}

/// See [`crate::kernels::softmax::largest`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn largest(lanes: [f32; LANES]) -> f32 {
    _mm512_reduce_max_ps(transmute!(lanes))
}

/// Most vectors of inputs whose sums fit into registers beside weights, two for each.
pub(super) const GROUP: usize = 8;

/// See [`crate::kernels::several::AddRows::parts`]: enough sums that none waits for its last addition.
///
/// With one part, multiplications take the input from memory. Where additions run beside them, registers cannot
/// be read fast enough for both.
pub(super) const fn parts(count: usize, fused: bool) -> usize {
    match count {
        1 => 4,
        2..=3 => 2,
        _ if fused => 2,
        _ => 1,
    }
}

/// See [`crate::kernels::several::AddRows::add_rows`].
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn add_rows<A: Arithmetic, const PARTS: usize, const COUNT: usize>(
    strip: Strip<'_>,
    start: [[f32; PART]; PARTS],
    inputs: [&[f32]; COUNT],
) -> [[[f32; PART]; PARTS]; COUNT] {
    let mut first = [_mm512_setzero_ps(); PARTS];
    for (vector, part) in first.iter_mut().zip(start) {
        *vector = transmute!(part);
    }
    let mut sums = [first; COUNT];
    for (row, inputs) in StripRows::<PARTS, COUNT>::new(strip, inputs) {
        let mut weights = [_mm512_setzero_ps(); PARTS];
        for (vector, part) in weights.iter_mut().zip(row) {
            *vector = transmute!(*part);
        }
        for (sums, input) in sums.iter_mut().zip(inputs) {
            let input = _mm512_set1_ps(*input);
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum = multiply_add::<A>(*sum, input, weight);
            }
        }
    }
    let mut results = [start; COUNT];
    for (result, sums) in results.iter_mut().zip(&sums) {
        for (result, sum) in result.iter_mut().zip(sums) {
            *result = transmute!(*sum);
        }
    }
    results
}

sparse::sparse_product! {
    /// See [`crate::kernels::product::sparse_product`]; the sums of two tiles fit into registers.
    __m512, _mm512_set1_ps, _mm512_loadu_ps, 2, true, "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl"
}

/// Patches whose sums fit into registers; their starts are as many as there are general registers.
pub(super) const PATCHES: usize = 14;

runs::add_runs! {
    /// See [`crate::kernels::patches::AddRuns::add_runs`].
    __m512, 1, _mm512_set1_ps, "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl"
}
