//! Products of int8 weights and int16 inputs, added up in i32: sums of integers, so that any order gives the same
//! bits.
//!
//! Inputs are scaled to integers anew for every vector ([`quantise`]): the largest becomes [`input_max`], which is
//! chosen so that no sum can leave i32, whatever the weights are. Weights are stored for pairs of inputs, as vector
//! instructions multiply them ([`Row`]). A sum becomes f32 once, at the end of its layer. Attention compares and mixes
//! rows of integers ([`IntegerRows`]).

mod attention;
pub(super) mod patches;
mod portable;
mod sparse;
#[cfg(test)]
mod tests;

pub use attention::{IntegerRows, mixing_max, narrow, row_max};
pub use patches::Int8PatchLayer;
pub(super) use patches::{IntegerTiles, add_runs};
pub use sparse::{Marked, SparseVector, Strips, sparse_product};

use super::patches::Runs;

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

/// Most vectors whose sums fit into registers beside the weights.
const GROUP: usize = 6;

/// Inputs whose absolute value is at most this are taken for zeros: the inverse of their scale is no f32.
pub(super) const NOTHING: f32 = 1.0e-30;

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

/// How far a vector's integers reach.
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    /// What at least counts as the largest absolute value of the inputs.
    pub least: f32,
    /// The integer that the largest becomes.
    pub most: u16,
}

impl Reach {
    /// For inputs of a product: `integers` of them are added up.
    #[inline(always)]
    pub fn of_inputs(integers: usize) -> Self {
        Self { least: 0.0, most: input_max(integers) }
    }
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
    /// The scale of a vector whose largest absolute value has these bits; none where it is no finite number.
    #[inline(always)]
    pub(super) fn reaching(largest: u32, reach: Reach) -> Option<Self> {
        let largest = u32::max(largest, reach.least.to_bits());
        if largest >= 0x7f80_0000 {
            return None;
        }
        let (largest, most) = (f32::from_bits(largest), f32::from(reach.most));
        Some(if largest > NOTHING {
            Self { factor: most / largest, step: largest / most }
        } else {
            Self { factor: 0.0, step: 0.0 }
        })
    }

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
    fn quantise(self, values: &[f32], reach: Reach, integers: &mut [i16]) -> Option<Scale>;

    /// One matrix times several vectors ([`products`]).
    fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]);

    /// A matrix times a vector of which much is zero ([`sparse_product`]).
    fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: SparseVector<'_>) -> Option<()>;

    /// A layer on the patches of a picture of integers, each of which counts `step`.
    fn int8_convolve(self, layer: &Int8PatchLayer<'_>, integers: &[i16], step: f32, to: &mut [f32]);

    /// Dot products of one vector with rows, each as the number that it counts: `step` times the row's.
    fn int8_dots(self, vector: &[i16], step: f32, rows: IntegerRows<'_>, products: &mut [f32]);

    /// The weighted sums of rows, of as many columns as there are sums: a multiple of [`INPUTS`].
    fn int8_mix(self, weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]);

    /// Makes short integers of sums ([`narrow`]).
    fn narrow(self, sums: &[i32], most: u16, integers: &mut [i16]) -> f32;
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

    /// The sums of a strip for several patches, whose numbers are multiplied as pairs.
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT];

    /// The sums of two strips for one vector.
    fn add_two_strips(self, rows: [&[[Row; PAIRS]]; 2], inputs: &[Inputs]) -> [[i32; STRIP]; 2];

    /// `COUNT` strips of a product, from a first one on, with inputs of which few pairs are not zero: sums and the
    /// numbers that come of them in one, so that sums never leave their registers.
    fn add_marked<const COUNT: usize>(
        self,
        strips: Strips<'_>,
        inputs: Marked<'_>,
        outputs: &mut [f32],
    );
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

/// Makes integers of numbers: the largest absolute value, or the least that counts as it, becomes the most that is asked for.
/// Integers behind the values are zero. None where a value is not a finite number.
#[inline(always)]
pub fn quantise(
    lanes: impl Lanes,
    values: &[f32],
    reach: Reach,
    integers: &mut [i16],
) -> Option<Scale> {
    let scale = Scale::reaching(lanes.largest_magnitude(values), reach)?;
    let (chunks, rest) = values.as_chunks::<STRIP>();
    let mut places = integers.as_chunks_mut().0.iter_mut();
    for (chunk, place) in chunks.iter().zip(places.by_ref()) {
        *place = lanes.integers(scale, chunk);
    }
    places.for_each(|place| *place = [0; STRIP]);
    if rest.is_empty() {
        return Some(scale);
    }
    let to = integers.get_mut(..values.len())?;
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
            let sums = lanes.add_two_strips([first, second], vector.inputs);
            matrix.finish(lanes, strip, &sums, vector.step, vector.outputs);
        } else {
            let sums = lanes.add_strip(first, [vector.inputs]);
            matrix.finish(lanes, strip, &sums, vector.step, vector.outputs);
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
        matrix.finish(lanes, strip, &[*sums], vector.step, vector.outputs);
    }
}

impl Matrix<'_> {
    /// Makes numbers of the sums of `COUNT` strips and writes them where the vector's outputs are.
    #[inline(always)]
    pub(super) fn finish<const COUNT: usize>(
        &self,
        lanes: impl Lanes,
        first: usize,
        sums: &[[i32; STRIP]; COUNT],
        step: f32,
        outputs: &mut [f32],
    ) {
        let Some(outputs) = outputs.get_mut(first * STRIP..) else { return };
        if let Some(whole) = outputs.as_chunks_mut().0.first_chunk_mut() {
            self.numbers(lanes, first, sums, step, whole);
            return;
        }
        let mut whole = [[0.0; STRIP]; COUNT];
        self.numbers(lanes, first, sums, step, &mut whole);
        for (output, number) in outputs.iter_mut().zip(whole.as_flattened()) {
            *output = *number;
        }
    }

    /// Makes numbers of the sums of `COUNT` strips.
    #[inline(always)]
    fn numbers<const COUNT: usize>(
        &self,
        lanes: impl Lanes,
        first: usize,
        sums: &[[i32; STRIP]; COUNT],
        step: f32,
        numbers: &mut [[f32; STRIP]; COUNT],
    ) {
        let bias = match self.bias {
            Some(bias) => chunks_from::<COUNT>(bias, first),
            None => Some(const { &[[0.0; STRIP]; COUNT] }),
        };
        let (Some(steps), Some(bias)) = (chunks_from::<COUNT>(self.steps, first), bias) else {
            return;
        };
        let counts = steps.iter().zip(bias);
        for ((numbers, sums), (steps, bias)) in numbers.iter_mut().zip(sums).zip(counts) {
            // Written at once, one strip after the other: arrays of them would be copied by calls.
            *numbers = lanes.numbers(sums, Count { step, steps, bias, relu: self.relu });
        }
    }
}

/// The floats of `COUNT` strips, from a first one on.
#[inline(always)]
fn chunks_from<const COUNT: usize>(floats: &[f32], first: usize) -> Option<&[[f32; STRIP]; COUNT]> {
    floats.as_chunks().0.get(first..)?.first_chunk()
}
