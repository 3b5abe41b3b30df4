//! Products of int8 weights and int16 inputs, added up in i32: sums of integers, so that any order gives the same
//! bits.
//!
//! Inputs are scaled to integers anew for every vector ([`quantise`]): the largest becomes [`input_max`], which is
//! chosen so that no sum can leave i32, whatever the weights are. Weights are stored for pairs of inputs, as vector
//! instructions multiply them ([`Row`]). A sum becomes f32 once, at the end of its layer.

use crate::math::relu;

/// Columns of weights that are worked on together.
pub const STRIP: usize = 16;

/// Two neighbouring inputs.
pub type Pair = [i16; 2];

/// Weights of a pair of inputs for the columns of a strip: of each column the first input's, then the second's.
pub type Row = [i8; 2 * STRIP];

/// Quantised inputs are filled up with zeros to a multiple of this.
pub const INPUTS: usize = 32;

/// Pairs of inputs that are worked on together; a matrix has whole groups of them.
pub const PAIRS: usize = 4;

/// A group of pairs of inputs.
pub type Inputs = [Pair; PAIRS];

/// Most strips whose sums are held together where few inputs are not zero.
const STRIPS: usize = 8;

/// Most vectors whose sums fit into registers beside the weights.
const GROUP: usize = 6;

/// Inputs whose absolute value is at most this are taken for zeros: the inverse of their scale is no f32.
const NOTHING: f32 = 1.0e-30;

/// 1.5 · 2²³: added to a number below 2²², it leaves the nearest integer, ties to even, in the low bits.
pub(super) const ROUND: f32 = 12_582_912.0;

/// The largest absolute value of a quantised input where `inputs` of them are added up.
///
/// A weight is at most 128 in absolute value, so a sum at most `inputs · 128 · input_max`, and that is below 2³¹:
/// up to 512 inputs by 512 · 128 · 32767 = 2³¹ - 2¹⁶, beyond by the division.
#[inline(always)]
pub fn input_max(inputs: usize) -> u16 {
    if inputs <= 512 {
        return i16::MAX as u16;
    }
    let most = 1_usize << 24;
    (most - 1).checked_div(inputs).unwrap_or(0) as u16
}

/// What makes integers of a vector's inputs, and numbers of integers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// An input times this, rounded, is its integer.
    pub factor: f32,
    /// An integer times this is its input.
    pub step: f32,
}

impl Scale {
    /// The integer of an input, at most as large as the one that the scale was made for.
    #[inline(always)]
    pub fn integer(self, input: f32) -> i16 {
        // The low half of the bits is the rounded number: the constant has zeros there.
        (input * self.factor + ROUND).to_bits() as i16
    }
}

/// A matrix of int8 weights, and what happens to its sums.
#[derive(Clone, Copy, Debug)]
pub struct Matrix<'a> {
    /// The weights. Of a product: strip after strip, in each a row for every pair of inputs. Of a product with few
    /// inputs: for every pair of inputs the rows of all strips.
    pub rows: &'a [Row],
    /// Groups of pairs of inputs.
    pub groups: usize,
    /// What a weight of each column counts, whole strips.
    pub steps: &'a [f32],
    /// What is added to each column, whole strips; none: nothing.
    pub bias: Option<&'a [f32]>,
    /// Whether a ReLU follows.
    pub relu: bool,
}

/// Quantised inputs, and the place of the outputs.
#[derive(Debug)]
pub struct Vector<'a> {
    /// The inputs, as many groups as the matrix has or more.
    pub inputs: &'a [Inputs],
    /// What an integer counts.
    pub step: f32,
    /// The outputs.
    pub outputs: &'a mut [f32],
}

/// The int8 kernels of one build.
pub trait Int8Kernels: Copy {
    /// Makes integers of numbers ([`quantise`]).
    fn quantise(self, values: &[f32], least: f32, integers: &mut [i16]) -> Option<Scale>;

    /// One matrix times several vectors ([`products`]).
    fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]);

    /// A matrix times a vector of which much is zero ([`sparse_product`]).
    fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: Vector<'_>);
}

/// What a build writes with its own instructions.
pub trait Lanes: Copy {
    /// The bits of the largest absolute value: those of numbers are in the order of the numbers.
    fn largest_magnitude(self, values: &[f32]) -> u32;

    /// [`Scale::integer`] of every value.
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP];

    /// Sums as numbers: each times what it counts, plus its bias.
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP];

    /// The sums of a strip for several vectors.
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT];

    /// The sums of two strips for one vector.
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2];

    /// The sums of `COUNT` strips, from a first one on, of pairs of which few are not zero.
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: &[Pair],
    ) -> [[i32; STRIP]; COUNT];
}

/// What the sums of a strip count.
#[derive(Clone, Copy, Debug)]
pub struct Count<'a> {
    /// What an integer input counts.
    pub step: f32,
    /// What a weight of each column counts.
    pub steps: &'a [f32; STRIP],
    /// What is added to each column.
    pub bias: &'a [f32; STRIP],
    /// Whether a ReLU follows.
    pub relu: bool,
}

/// Makes integers of numbers: the largest absolute value, or `least` where that is larger, becomes [`input_max`].
/// Integers behind the values are zero. None where a value is not a finite number.
#[inline(always)]
pub fn quantise(
    lanes: impl Lanes,
    values: &[f32],
    least: f32,
    integers: &mut [i16],
) -> Option<Scale> {
    let largest = u32::max(lanes.largest_magnitude(values), least.to_bits());
    if largest >= 0x7f80_0000 {
        return None;
    }
    let (largest, most) = (f32::from_bits(largest), f32::from(input_max(integers.len())));
    let scale = if largest > NOTHING {
        Scale { factor: most / largest, step: largest / most }
    } else {
        Scale { factor: 0.0, step: 0.0 }
    };
    for zeros in integers.as_chunks_mut::<INPUTS>().0 {
        *zeros = [0; INPUTS];
    }
    let to = integers.get_mut(..values.len())?;
    let (chunks, rest) = values.as_chunks::<STRIP>();
    for (place, chunk) in to.as_chunks_mut().0.iter_mut().zip(chunks) {
        *place = lanes.integers(scale, chunk);
    }
    if rest.is_empty() {
        return Some(scale);
    }
    // Computing some of them once more changes nothing.
    if let (Some(chunk), Some(place)) = (values.last_chunk::<STRIP>(), to.last_chunk_mut()) {
        *place = lanes.integers(scale, chunk);
    } else {
        for (place, value) in to.iter_mut().zip(rest) {
            *place = scale.integer(*value);
        }
    }
    Some(scale)
}

/// Writes the product of a matrix and each vector to its outputs.
#[inline(always)]
pub fn products(lanes: impl Lanes, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
    if let [vector] = vectors {
        return product(lanes, matrix, vector);
    }
    // Groups of equal size: eight vectors are two times four.
    let groups = vectors.len().div_ceil(GROUP).max(1);
    let group = vectors.len().div_ceil(groups).max(1);
    let rows = matrix.rows.as_chunks().0;
    for (strip, rows) in rows.chunks_exact(matrix.groups.max(1)).enumerate() {
        for vectors in vectors.chunks_mut(group) {
            match vectors.len() {
                1 => add_strip::<1>(lanes, matrix, (strip, rows), vectors),
                2 => add_strip::<2>(lanes, matrix, (strip, rows), vectors),
                3 => add_strip::<3>(lanes, matrix, (strip, rows), vectors),
                4 => add_strip::<4>(lanes, matrix, (strip, rows), vectors),
                5 => add_strip::<5>(lanes, matrix, (strip, rows), vectors),
                _ => add_strip::<GROUP>(lanes, matrix, (strip, rows), vectors),
            }
        }
    }
}

/// As [`products`] for one vector: two strips together, so that inputs are read once for both.
#[inline(always)]
fn product(lanes: impl Lanes, matrix: &Matrix<'_>, vector: &mut Vector<'_>) {
    let strips = matrix.rows.as_chunks().0.chunks_exact(matrix.groups.max(1));
    let mut strips = strips.enumerate();
    while let Some((strip, first)) = strips.next() {
        if let Some((_, second)) = strips.next() {
            let [low, high] = lanes.add_two_strips([first, second], vector.inputs);
            matrix.finish(lanes, strip, &low, vector);
            matrix.finish(lanes, strip + 1, &high, vector);
        } else {
            let [sums] = lanes.add_strip(first, [vector.inputs]);
            matrix.finish(lanes, strip, &sums, vector);
        }
    }
}

/// One strip of a matrix for `COUNT` vectors.
#[inline(always)]
fn add_strip<const COUNT: usize>(
    lanes: impl Lanes,
    matrix: &Matrix<'_>,
    (strip, rows): (usize, &[[Row; PAIRS]]),
    vectors: &mut [Vector<'_>],
) {
    let Some(vectors) = vectors.first_chunk_mut::<COUNT>() else { return };
    let mut inputs = [&[] as &[Inputs]; COUNT];
    for (inputs, vector) in inputs.iter_mut().zip(vectors.iter()) {
        *inputs = vector.inputs;
    }
    let sums = lanes.add_strip(rows, inputs);
    for (sums, vector) in sums.iter().zip(vectors) {
        matrix.finish(lanes, strip, sums, vector);
    }
}

/// As [`products`] for one vector of which few pairs of inputs are not zero; the matrix stores all strips of a pair
/// side by side.
#[inline(always)]
pub fn sparse_product(lanes: impl Lanes, matrix: &Matrix<'_>, mut vector: Vector<'_>) {
    let all = vector.outputs.len().div_ceil(STRIP);
    let mut strips = Strips { rows: matrix.rows, all, first: 0 };
    while strips.first < all {
        strips.first += match all - strips.first {
            STRIPS.. => add_marked::<STRIPS>(lanes, matrix, strips, &mut vector),
            4.. => add_marked::<4>(lanes, matrix, strips, &mut vector),
            2.. => add_marked::<2>(lanes, matrix, strips, &mut vector),
            _ => add_marked::<1>(lanes, matrix, strips, &mut vector),
        };
    }
}

/// `COUNT` of a matrix's strips for a vector. Returns how many were done.
#[inline(always)]
fn add_marked<const COUNT: usize>(
    lanes: impl Lanes,
    matrix: &Matrix<'_>,
    strips: Strips<'_>,
    vector: &mut Vector<'_>,
) -> usize {
    let sums = lanes.add_marked::<COUNT>(strips, vector.inputs.as_flattened());
    for (strip, sums) in (strips.first..).zip(&sums) {
        matrix.finish(lanes, strip, sums, vector);
    }
    COUNT
}

/// Strips of a matrix that stores those of a pair side by side.
#[derive(Clone, Copy, Debug)]
pub struct Strips<'a> {
    /// The matrix.
    pub rows: &'a [Row],
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
        inputs: &[Pair],
        not_zero: impl Fn(&[Pair; STRIP]) -> u16,
        mut add: impl FnMut(&'a [Row; COUNT], Pair),
    ) {
        for (start, pairs) in (0..).step_by(4 * STRIP).zip(inputs.chunks(4 * STRIP)) {
            let mut marks = 0;
            for (part, pairs) in pairs.as_chunks().0.iter().enumerate() {
                marks |= u64::from(not_zero(pairs)) << (part * STRIP);
            }
            while marks != 0 {
                let index = marks.trailing_zeros() as usize;
                marks &= marks - 1;
                // Far from overflow: inputs and outputs are numbers of 16 bits.
                let place = (start + index).wrapping_mul(self.all).wrapping_add(self.first);
                let rows = self.rows.get(place..).and_then(|rows| rows.first_chunk());
                let (Some(rows), Some(pair)) = (rows, pairs.get(index)) else { break };
                add(rows, *pair);
            }
        }
    }
}

impl Matrix<'_> {
    /// Makes numbers of a strip's sums and writes them where the vector's outputs are.
    #[inline(always)]
    fn finish(
        &self,
        lanes: impl Lanes,
        strip: usize,
        sums: &[i32; STRIP],
        vector: &mut Vector<'_>,
    ) {
        let Some(steps) = self.steps.as_chunks().0.get(strip) else { return };
        let bias = self.bias.and_then(|bias| bias.as_chunks().0.get(strip));
        let bias = bias.unwrap_or(&[0.0; STRIP]);
        let count = Count { step: vector.step, steps, bias, relu: self.relu };
        let numbers = lanes.numbers(sums, count);
        let Some(outputs) = vector.outputs.get_mut(strip * STRIP..) else { return };
        match outputs.first_chunk_mut() {
            Some(outputs) => *outputs = numbers,
            None => {
                for (output, number) in outputs.iter_mut().zip(numbers) {
                    *output = number;
                }
            }
        }
    }
}

impl<A> Lanes for super::Portable<A> {
    #[inline(always)]
    fn largest_magnitude(self, values: &[f32]) -> u32 {
        let magnitude = |value: &f32| value.to_bits() & 0x7fff_ffff;
        values.iter().map(magnitude).fold(0, u32::max)
    }

    #[inline(always)]
    fn integers(self, scale: Scale, values: &[f32; STRIP]) -> [i16; STRIP] {
        values.map(|value| scale.integer(value))
    }

    #[inline(always)]
    fn numbers(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        let mut numbers = [0.0; STRIP];
        let counts = count.steps.iter().zip(count.bias);
        for ((number, sum), (step, bias)) in numbers.iter_mut().zip(sums).zip(counts) {
            let sum = *sum as f32 * (count.step * step) + bias;
            *number = if count.relu { relu(sum) } else { sum };
        }
        numbers
    }

    #[inline(always)]
    fn add_strip<const COUNT: usize>(
        self,
        rows: &[[Row; PAIRS]],
        inputs: [&[Inputs]; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        let mut sums = [[0; STRIP]; COUNT];
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            for (row, pair) in rows.as_flattened().iter().zip(inputs.as_flattened()) {
                add_row(sums, row, *pair);
            }
        }
        sums
    }

    #[inline(always)]
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2] {
        let mut sums = [[0; STRIP]; 2];
        for (sums, rows) in sums.iter_mut().zip(rows) {
            for (row, pair) in rows.as_flattened().iter().zip(inputs.as_flattened()) {
                add_row(sums, row, *pair);
            }
        }
        sums
    }

    #[inline(always)]
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: &[Pair],
    ) -> [[i32; STRIP]; COUNT] {
        let mut sums = [[0; STRIP]; COUNT];
        strips.for_each::<COUNT>(inputs, not_zero, |rows, pair| {
            for (sums, row) in sums.iter_mut().zip(rows) {
                add_row(sums, row, pair);
            }
        });
        sums
    }
}

/// A bit for each pair that is not zero.
fn not_zero(pairs: &[Pair; STRIP]) -> u16 {
    let mut marks = 0;
    for (index, pair) in pairs.iter().enumerate() {
        marks |= u16::from(*pair != [0; 2]) << index;
    }
    marks
}

#[inline(always)]
fn add_row(sums: &mut [i32; STRIP], row: &Row, [first, second]: Pair) {
    let (first, second) = (i32::from(first), i32::from(second));
    for (sum, [a, b]) in sums.iter_mut().zip(row.as_chunks().0) {
        // Never wraps, see `input_max`.
        *sum = sum.wrapping_add(i32::from(*a) * first + i32::from(*b) * second);
    }
}

impl<A> Int8Kernels for super::Portable<A> {
    fn quantise(self, values: &[f32], least: f32, integers: &mut [i16]) -> Option<Scale> {
        quantise(self, values, least, integers)
    }

    fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
        products(self, matrix, vectors);
    }

    fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: Vector<'_>) {
        sparse_product(self, matrix, vector);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Portable;
    use super::super::arithmetic::Exact;
    use super::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn no_sum_leaves_i32() {
        for inputs in [1, 2, 31, 64, 511, 512, 513, 1000, 8191, 65_535] {
            let most = i64::from(input_max(inputs));
            let largest_sum = inputs as i64 * 128 * most;
            assert!(most >= 1 && largest_sum <= i64::from(i32::MAX), "{inputs}: {largest_sum}");
        }
        assert_eq!((input_max(512), input_max(513)), (32_767, 32_704));
        let inputs = [[[-32_767; 2]; PAIRS]; 64];
        let rows = [[[-128; 2 * STRIP]; PAIRS]; 64];
        let sums = Portable::<Exact>::new().add_strip(&rows, [&inputs]);
        assert_eq!(sums, [[512 * 128 * 32_767; STRIP]]);
    }

    #[test]
    fn integers_are_the_nearest() {
        for len in [1, 7, 15, 16, 17, 31, 58, 70, 128] {
            let values: Vec<f32> = (0..len).map(|i| (i as f32 - 20.0) / 7.0).collect();
            let largest = values.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
            let mut integers = vec![-7; 160];
            let scale = Portable::<Exact>::new().quantise(&values, 0.0, &mut integers).unwrap();
            assert!((scale.step * 32_767.0 - largest).abs() < 1e-6 * largest);
            for (value, integer) in values.iter().zip(&integers) {
                let error = (value - f32::from(*integer) * scale.step).abs();
                assert!(error <= 0.51 * scale.step, "{value} became {integer} of {len}");
            }
            assert!(integers[len..].iter().all(|integer| *integer == 0));
            let largest = integers.iter().map(|integer| integer.unsigned_abs()).max();
            assert_eq!(largest, Some(32_767));
        }
    }

    #[test]
    fn a_scale_reaches_as_far_as_is_asked() {
        let mut integers = [1; 32];
        let scale = Portable::<Exact>::new().quantise(&[0.25, -0.5], 1.0, &mut integers).unwrap();
        assert_eq!((scale.integer(1.0), integers[0], integers[1]), (32_767, 8192, -16_384));
    }

    #[test]
    fn next_to_nothing_is_nothing_and_no_number_is_refused() {
        let mut integers = [1; 32];
        for values in [[0.0, -0.0], [1e-40, -1e-31], [f32::MIN_POSITIVE, 0.0]] {
            let scale = Portable::<Exact>::new().quantise(&values, 0.0, &mut integers).unwrap();
            assert_eq!((scale.step, integers), (0.0, [0; 32]));
        }
        for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(Portable::<Exact>::new().quantise(&[0.5, bad], 0.0, &mut integers), None);
        }
        let scale =
            Portable::<Exact>::new().quantise(&[f32::MAX, f32::MIN], 0.0, &mut integers).unwrap();
        assert!(scale.factor > 0.0 && integers[..2] == [32_767, -32_767]);
    }

    #[test]
    fn sums_become_numbers_once() {
        let kernels = Portable::<Exact>::new();
        // Column c of the only pair has the weights c and 1.
        let mut row = [1; 2 * STRIP];
        for (column, [weight, _]) in row.as_chunks_mut::<2>().0.iter_mut().enumerate() {
            *weight = column as i8;
        }
        let (steps, bias) = ([0.5; STRIP], [-3.0; STRIP]);
        let rows = [row, [0; 2 * STRIP], [0; 2 * STRIP], [0; 2 * STRIP]];
        let mut matrix = Matrix { rows: &rows, groups: 1, steps: &steps, bias: None, relu: false };
        let ask = |matrix: &Matrix<'_>, sparse: bool| {
            let (mut inputs, mut outputs) = ([[[0; 2]; PAIRS]; STRIP], [f32::NAN; 8]);
            inputs[0][0] = [4, 10];
            let vector = Vector { inputs: &inputs, step: 0.25, outputs: &mut outputs };
            if sparse {
                kernels.int8_sparse_product(matrix, vector);
            } else {
                kernels.int8_products(matrix, &mut [vector]);
            }
            outputs
        };
        let want: [f32; 8] = std::array::from_fn(|column| (4 * column + 10) as f32 * 0.125);
        assert_eq!((ask(&matrix, false), ask(&matrix, true)), (want, want));
        matrix = Matrix { bias: Some(&bias), relu: true, ..matrix };
        assert_eq!(ask(&matrix, false), want.map(|number| (number - 3.0).max(0.0)));
    }
}
