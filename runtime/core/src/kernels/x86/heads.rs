//! Attention of several heads at once for AVX-512: rows are loaded once for all of them, no head waits for another,
//! and weights that are needed next come near meanwhile.

use core::arch::x86_64::{
    __m512, _MM_HINT_T0, _mm_prefetch, _mm512_add_ps, _mm512_fpclass_ps_mask, _mm512_mask_blend_ps,
    _mm512_maskz_mov_ps, _mm512_mul_ps, _mm512_reduce_max_ps, _mm512_set1_ps, _mm512_setzero_ps,
    _mm512_shuffle_f32x4, _mm512_shuffle_ps, _mm512_sub_ps,
};

use zerocopy::transmute;

use super::wider::{NOT_FINITE, join, lanes_of, largest, load, multiply_add};
use crate::kernels::arithmetic::Arithmetic;
use crate::kernels::dot::{LANES, ROWS};
use crate::kernels::product::TILE;
use crate::kernels::rows::Rows;
use crate::kernels::softmax::{self, Scores};
use crate::kernels::{ATTENDED_WIDTH, HEADS, Heads};
use crate::math::exp;

/// Vectors of a tile.
const VECTORS: usize = TILE / LANES;
/// Vectors of the columns that may stand behind the last whole tile, if rows are narrower than two.
const NARROW: usize = ATTENDED_WIDTH / LANES;

/// Rows that are attended to: their scores fit into one vector.
pub(super) const ATTENDED: usize = LANES;

/// Groups that are worked on step by step together, so that none waits for its own last step.
const GROUPS: usize = 4;

/// See [`crate::kernels::Kernels::attend`].
// Inlined into a whole decision, its sums do not stay in registers.
#[inline(never)]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn attend<A: Arithmetic>(groups: &mut [Heads<'_>], soon: &[f32]) -> bool {
    let mut soon = Soon(soon);
    let mut finite = true;
    for groups in groups.chunks_mut(GROUPS) {
        let mut scores = [[_mm512_setzero_ps(); HEADS]; GROUPS];
        for (group, scores) in groups.iter().zip(&mut scores) {
            *scores = weigh::<A>(group, &mut soon);
        }
        for (group, scores) in groups.iter().zip(&mut scores) {
            let count = group.keys.slots.len().min(ATTENDED);
            finite &= softmax(scores, [exist(count); HEADS], &mut soon) == [0; HEADS];
        }
        for (group, scores) in groups.iter_mut().zip(scores) {
            mix_all::<A>(group, scores, &mut soon);
        }
    }
    finite
}

/// See [`crate::kernels::Kernels::softmaxes`]: of scores that fit into a vector four at a time.
// Inlined into a whole decision, its vectors do not stay in registers.
#[inline(never)]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(super) fn softmaxes(several: &mut [Scores<'_>]) {
    for four in several.chunks_mut(HEADS) {
        let mut vectors = [_mm512_setzero_ps(); HEADS];
        let mut exists = [0; HEADS];
        for (one, (vector, exists)) in four.iter_mut().zip(vectors.iter_mut().zip(&mut exists)) {
            match <&[f32; LANES]>::try_from(&*one.scores) {
                Ok(scores) => (*vector, *exists) = (load(scores), exist(one.count)),
                Err(_) => {
                    one.finite = softmax::softmax(one.scores, one.count, |lanes| largest(lanes))
                }
            }
        }
        let not_finite = softmax(&mut vectors, exists, &mut Soon(&[]));
        for (one, (vector, not_finite)) in four.iter_mut().zip(vectors.iter().zip(not_finite)) {
            if let Ok(scores) = <&mut [f32; LANES]>::try_from(&mut *one.scores) {
                *scores = transmute!(*vector);
                one.finite = not_finite == 0;
            }
        }
    }
}

/// A bit for each of so many scores of a vector.
#[inline(always)]
fn exist(count: usize) -> u16 {
    (u32::from(u16::MAX) >> ATTENDED.saturating_sub(count)) as u16
}

/// The scores of a group's heads, a vector each.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn weigh<A: Arithmetic>(group: &Heads<'_>, soon: &mut Soon<'_>) -> [__m512; HEADS] {
    let mut scores = [_mm512_setzero_ps(); ATTENDED / ROWS];
    for (scores, slots) in scores.iter_mut().zip(group.keys.slots.chunks(ROWS)) {
        *scores = join_all(dots::<A>(&group.heads, four_rows(group.keys, slots), soon));
    }
    // Four rows of every head become all rows of each.
    let [a, b, c, d] = scores;
    let low = [_mm512_shuffle_f32x4::<0x44>(a, b), _mm512_shuffle_f32x4::<0x44>(c, d)];
    let high = [_mm512_shuffle_f32x4::<0xee>(a, b), _mm512_shuffle_f32x4::<0xee>(c, d)];
    let [[a, b], [c, d]] = [low, high];
    [
        _mm512_shuffle_f32x4::<0x88>(a, b),
        _mm512_shuffle_f32x4::<0xdd>(a, b),
        _mm512_shuffle_f32x4::<0x88>(c, d),
        _mm512_shuffle_f32x4::<0xdd>(c, d),
    ]
}

/// [`crate::kernels::dot::join`] of all sums: four rows' of the first head, then of the next.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn join_all(sums: [[__m512; ROWS]; HEADS]) -> __m512 {
    let [first, second, third, fourth] = sums;
    let [a, b] = [join_two(first, second), join_two(third, fourth)];
    _mm512_add_ps(_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0xdd>(a, b))
}

/// Two halves that are still to be added for every row of two heads, next to each other.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn join_two(first: [__m512; ROWS], second: [__m512; ROWS]) -> __m512 {
    let mut eights = first;
    for (eight, second) in eights.iter_mut().zip(second) {
        let low = _mm512_shuffle_f32x4::<0x44>(*eight, second);
        *eight = _mm512_add_ps(low, _mm512_shuffle_f32x4::<0xee>(*eight, second));
    }
    let [a, b, c, d] = eights;
    add_neighbours(add_neighbours(a, b), add_neighbours(c, d))
}

/// Sums of neighbours, in every fourth of the vectors the first's before the second's.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn add_neighbours(a: __m512, b: __m512) -> __m512 {
    _mm512_add_ps(_mm512_shuffle_ps::<0x88>(a, b), _mm512_shuffle_ps::<0xdd>(a, b))
}

/// Makes a group's heads the weighted sums of its values.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn mix_all<A: Arithmetic>(group: &mut Heads<'_>, scores: [__m512; HEADS], soon: &mut Soon<'_>) {
    let [a, b, c, d] = scores;
    let weights = [transmute!(a), transmute!(b), transmute!(c), transmute!(d)];
    let (heads, values) = (&mut group.heads, group.values);
    let tiled = values.width - values.width % TILE;
    for first in (0..tiled).step_by(TILE) {
        mix::<A, TILE, VECTORS>(heads, &weights, values, first, soon);
    }
    if values.width > tiled {
        mix::<A, ATTENDED_WIDTH, NARROW>(heads, &weights, values, tiled, soon);
    }
}

/// The rows in at most four slots. Where slots end, the first one stands for those that are missing.
#[inline(always)]
fn four_rows<'r>(rows: Rows<'r>, slots: &[u16]) -> [&'r [f32]; ROWS] {
    let mut four = [&[][..]; ROWS];
    for (index, row) in four.iter_mut().enumerate() {
        if let Some(slot) = slots.get(index).or(slots.first()) {
            *row = rows.row(*slot);
        }
    }
    four
}

/// Sums of which each is [`join`]ed to the dot product of a head and a row.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn dots<A: Arithmetic>(
    heads: &[&mut [f32]; HEADS],
    rows: [&[f32]; ROWS],
    soon: &mut Soon<'_>,
) -> [[__m512; ROWS]; HEADS] {
    let [h0, h1, h2, h3] = heads;
    let [h0, h1, h2, h3] = [lanes_of(h0), lanes_of(h1), lanes_of(h2), lanes_of(h3)];
    let [r0, r1, r2, r3] = rows;
    let [r0, r1, r2, r3] = [lanes_of(r0), lanes_of(r1), lanes_of(r2), lanes_of(r3)];
    let heads = h0.iter().zip(h1).zip(h2).zip(h3);
    let rows = r0.iter().zip(r1).zip(r2).zip(r3);
    let mut sums = [[_mm512_setzero_ps(); ROWS]; HEADS];
    for ((((h0, h1), h2), h3), (((r0, r1), r2), r3)) in heads.zip(rows) {
        soon.fetch::<6>();
        let rows = [load(r0), load(r1), load(r2), load(r3)];
        for (sums, head) in sums.iter_mut().zip([h0, h1, h2, h3]) {
            let head = load(head);
            for (sum, row) in sums.iter_mut().zip(rows) {
                *sum = multiply_add::<A>(*sum, head, row);
            }
        }
    }
    sums
}

/// See [`crate::kernels::softmax::softmax`]; `exist` has a bit for every score, the result for every one that is not finite.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn softmax(scores: &mut [__m512; HEADS], exist: [u16; HEADS], soon: &mut Soon<'_>) -> [u16; HEADS] {
    let mut not_finite = [0; HEADS];
    for (scores, (exist, not_finite)) in
        scores.iter_mut().zip(exist.into_iter().zip(&mut not_finite))
    {
        soon.fetch::<16>();
        *scores = _mm512_mask_blend_ps(exist, _mm512_set1_ps(f32::MIN), *scores);
        *not_finite = _mm512_fpclass_ps_mask::<{ NOT_FINITE }>(*scores);
        let largest = _mm512_set1_ps(_mm512_reduce_max_ps(*scores));
        let mut lanes: [f32; LANES] = transmute!(_mm512_sub_ps(*scores, largest));
        for lane in &mut lanes {
            *lane = exp(*lane);
        }
        *scores = _mm512_maskz_mov_ps(exist, load(&lanes));
    }
    let sums = join(*scores);
    for (scores, sum) in scores.iter_mut().zip(sums) {
        *scores = _mm512_mul_ps(*scores, _mm512_set1_ps(1.0 / sum));
    }
    not_finite
}

/// Writes the weighted sums of some columns, the first of which is `first`, over those of the heads.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn mix<A: Arithmetic, const COLUMNS: usize, const VECTORS: usize>(
    heads: &mut [&mut [f32]; HEADS],
    weights: &[[f32; LANES]; HEADS],
    rows: Rows<'_>,
    first: usize,
    soon: &mut Soon<'_>,
) {
    let mut sums = [[_mm512_setzero_ps(); VECTORS]; HEADS];
    let [w0, w1, w2, w3] = weights;
    for (slot, (((w0, w1), w2), w3)) in rows.slots.iter().zip(w0.iter().zip(w1).zip(w2).zip(w3)) {
        let columns = rows.row(*slot).get(first..).and_then(|row| row.first_chunk::<COLUMNS>());
        let Some(columns) = columns else { return };
        soon.fetch::<6>();
        let mut vectors = [_mm512_setzero_ps(); VECTORS];
        for (vector, lanes) in vectors.iter_mut().zip(lanes_of(columns)) {
            *vector = load(lanes);
        }
        for (sums, weight) in sums.iter_mut().zip([w0, w1, w2, w3]) {
            let weight = _mm512_set1_ps(*weight);
            for (sum, columns) in sums.iter_mut().zip(vectors) {
                *sum = multiply_add::<A>(*sum, weight, columns);
            }
        }
    }
    for (head, sums) in heads.iter_mut().zip(sums) {
        let columns =
            head.get_mut(first..).map_or(&mut [][..], |head| head.as_chunks_mut::<LANES>().0);
        for (columns, sum) in columns.iter_mut().zip(sums) {
            *columns = transmute!(sum);
        }
    }
}

/// Weights that are needed soon: the second cache, where they are, has nothing to do while heads are attended to.
struct Soon<'w>(&'w [f32]);

impl Soon<'_> {
    /// Brings the next cache lines near, about as many as arrive until the next call.
    #[inline(always)]
    #[allow(unsafe_code)]
    fn fetch<const LINES: usize>(&mut self) {
        const LINE: usize = 64 / size_of::<f32>();
        let Some(lines) = self.0.split_off(..LINES * LINE) else { return };
        for line in lines.as_chunks::<LINE>().0 {
            // SAFETY: every processor with AVX-512 has the instruction, which changes nothing but caches.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
        }
    }
}
