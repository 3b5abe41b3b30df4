//! The product of an int8 matrix and a vector of which much is zero.

use super::{Lanes, Matrix, Pair, Reach, Row, STRIP, quantise};

/// Pairs that are marked together.
const MARKED: usize = 64;

/// Most strips whose sums are held together where few inputs are not zero.
const STRIPS: usize = 8;

/// Inputs of which much is zero, and the place of the outputs.
#[derive(Debug)]
pub struct SparseVector<'a> {
    /// The first inputs.
    pub values: &'a [f32],
    /// The one input behind them that is one and not zero, where there is one.
    pub one: Option<usize>,
    /// Where the quantised inputs go, of all.
    pub integers: &'a mut [i16],
    /// The outputs.
    pub outputs: &'a mut [f32],
}

impl SparseVector<'_> {
    /// How far its integers reach: the one is an input as well.
    #[inline(always)]
    pub(crate) fn reach(&self) -> Reach {
        let least = if self.one.is_some() { 1.0 } else { 0.0 };
        Reach { least, ..Reach::of_inputs(self.integers.len()) }
    }
}

/// As [`super::products`] for one vector of which few pairs of inputs are not zero, and which is quantised first; the matrix
/// stores all strips of a pair side by side. None where an input is not a finite number.
#[inline(always)]
pub fn sparse_product(
    lanes: impl Lanes,
    matrix: &Matrix<'_>,
    vector: SparseVector<'_>,
) -> Option<()> {
    let reach = vector.reach();
    let SparseVector { values, one, integers, outputs } = vector;
    let scale = quantise(lanes, values, reach, integers)?;
    if let Some(place) = one.and_then(|one| integers.get_mut(one)) {
        *place = scale.integer(1.0);
    }
    let inputs = Marked { pairs: integers.as_chunks().0, values, one, step: scale.step };
    let all = outputs.len().div_ceil(STRIP);
    let mut strips = Strips { matrix, all, first: 0 };
    while strips.first < all {
        strips.first += match all - strips.first {
            STRIPS.. => add_marked::<STRIPS>(lanes, strips, inputs, outputs),
            4.. => add_marked::<4>(lanes, strips, inputs, outputs),
            2.. => add_marked::<2>(lanes, strips, inputs, outputs),
            _ => add_marked::<1>(lanes, strips, inputs, outputs),
        };
    }
    Some(())
}

/// `COUNT` of a matrix's strips for a vector. Returns how many were done.
#[inline(always)]
fn add_marked<const COUNT: usize>(
    lanes: impl Lanes,
    strips: Strips<'_>,
    inputs: Marked<'_>,
    outputs: &mut [f32],
) -> usize {
    lanes.add_marked::<COUNT>(strips, inputs, outputs);
    COUNT
}

/// Quantised inputs, and what tells which pairs of them are not zero.
#[derive(Clone, Copy, Debug)]
pub struct Marked<'a> {
    /// The quantised inputs.
    pub pairs: &'a [Pair],
    /// What the first of them were: known before the quantised are, so that nothing waits for those.
    pub values: &'a [f32],
    /// The input behind the values that is not zero.
    pub one: Option<usize>,
    /// What an integer counts.
    pub step: f32,
}

impl Marked<'_> {
    /// A bit for each of 64 pairs from `start` on that is not zero, and maybe for some that are: they add nothing.
    #[inline(always)]
    fn marks(&self, start: usize, not_zero: &impl Fn(&[f32; STRIP]) -> u8) -> u64 {
        let values = self.values.get(2 * start..).unwrap_or(&[]);
        let values = values.get(..2 * MARKED).unwrap_or(values);
        let mut marks = 0;
        for (chunk, first) in values.as_chunks().0.iter().zip((0..).step_by(STRIP / 2)) {
            marks |= u64::from(not_zero(chunk)) << first;
        }
        // The last whole pairs, some of them once more.
        let even = values.len() & !1;
        match values.get(..even).and_then(|values| values.last_chunk()) {
            Some(chunk) => marks |= u64::from(not_zero(chunk)) << ((even - STRIP) / 2),
            None => marks = (1 << (even / 2)) - 1,
        }
        if even < values.len() {
            marks |= 1 << (even / 2);
        }
        if let Some(one) = self.one.and_then(|one| (one / 2).checked_sub(start))
            && one < MARKED
        {
            marks |= 1 << one;
        }
        marks
    }
}

/// Strips of a matrix that stores those of a pair side by side.
#[derive(Clone, Copy, Debug)]
pub struct Strips<'a> {
    /// The matrix.
    pub matrix: &'a Matrix<'a>,
    /// Its strips.
    pub all: usize,
    /// The first strip that is meant.
    pub first: usize,
}

impl<'a> Strips<'a> {
    /// Shows `add` every pair of inputs that is not zero, with its weights.
    #[inline(always)]
    pub fn for_each<const COUNT: usize>(
        self,
        inputs: Marked<'_>,
        not_zero: impl Fn(&[f32; STRIP]) -> u8,
        mut add: impl FnMut(&'a [Row; COUNT], Pair),
    ) {
        for (start, pairs) in (0..).step_by(MARKED).zip(inputs.pairs.chunks(MARKED)) {
            let mut marks = inputs.marks(start, &not_zero);
            while marks != 0 {
                let index = marks.trailing_zeros() as usize;
                marks &= marks - 1;
                // Far from overflow: inputs and outputs are numbers of 16 bits.
                let place = (start + index).wrapping_mul(self.all).wrapping_add(self.first);
                let rows = self.matrix.rows.get(place..).and_then(|rows| rows.first_chunk());
                let (Some(rows), Some(pair)) = (rows, pairs.get(index)) else { break };
                add(rows, *pair);
            }
        }
    }
}
