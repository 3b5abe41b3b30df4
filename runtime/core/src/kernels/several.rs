//! One matrix times several vectors: weights are read once for all of them.

use heapless::Vec;

use super::arithmetic::{Arithmetic, Exact};
use super::mark::{MARKED, mark};
use super::product::{Around, add_row, finished, tile_width};

/// A vector of inputs, and the place of its outputs, whose length is a multiple of eight.
#[derive(Debug)]
pub struct Pair<'a> {
    /// The inputs, as many in every pair.
    pub inputs: &'a [f32],
    /// The outputs, as many in every pair.
    pub outputs: &'a mut [f32],
}

/// Columns that are counted together: what a tile of 64, 32 or 16 is made of.
pub const PART: usize = 16;

/// Adds up rows of weights for several vectors.
pub trait AddRows: Copy {
    /// Most vectors whose sums are worked on together.
    const GROUP: usize;

    /// The parts of a row whose sums fit into registers for `count` vectors: 4, 2 or 1.
    fn parts<A: Arithmetic>(self, count: usize) -> usize;

    /// For every vector `start`, plus each row of the strip times the vector's input, one row after the other.
    /// There are as many inputs as rows.
    fn add_rows<A: Arithmetic, const PARTS: usize, const COUNT: usize>(
        self,
        strip: Strip<'_>,
        start: [[f32; PART]; PARTS],
        inputs: [&[f32]; COUNT],
    ) -> [[[f32; PART]; PARTS]; COUNT];
}

/// Some neighbouring columns of a tile.
#[derive(Clone, Copy, Debug)]
pub struct Strip<'w> {
    /// The tile.
    pub tile: &'w [f32],
    /// The tile's columns.
    pub width: usize,
    /// The first column of the strip within the tile.
    pub first: usize,
}

/// Writes the product of a matrix and every pair's inputs to its outputs, each with the bits that
/// [`super::product::product`] gives.
#[inline(always)]
pub fn products<A: Arithmetic, R: AddRows>(
    adder: R,
    weights: &[f32],
    pairs: &mut [Pair<'_>],
    around: Around<'_>,
) {
    let Some(Pair { inputs, outputs }) = pairs.first() else { return };
    let (rows, columns) = (inputs.len(), outputs.len());
    // Groups of equal size: ten vectors are two times five.
    let groups = pairs.len().div_ceil(R::GROUP).max(1);
    let group = pairs.len().div_ceil(groups).max(1);
    let mut weights = weights;
    let mut column = 0;
    while column < columns {
        let width = tile_width(columns - column);
        let Some(tile) = weights.split_off(..rows.saturating_mul(width)) else { return };
        if width < PART {
            let (fours, rest) = pairs.as_chunks_mut();
            fours.iter_mut().for_each(|four| add_narrow::<A, 4>(tile, column, four, around));
            let (ones, _) = rest.as_chunks_mut();
            ones.iter_mut().for_each(|one| add_narrow::<A, 1>(tile, column, one, around));
        }
        for pairs in pairs.chunks_mut(group) {
            let parts = adder.parts::<A>(pairs.len()).min(width / PART).max(1);
            // The last tile, eight columns wide, has no strip.
            for first in (0..width / PART).map(|part| part * PART).step_by(parts) {
                let strip = Strip { tile, width, first };
                let column = column + first;
                match parts {
                    4 => add_strip::<A, R, 4>(adder, strip, column, pairs, around),
                    2 => add_strip::<A, R, 2>(adder, strip, column, pairs, around),
                    _ => add_strip::<A, R, 1>(adder, strip, column, pairs, around),
                }
            }
        }
        column += width;
    }
}

/// Writes the products of vectors, as long as `inner`, and a matrix that stands row after row, `columns` wide: any number
/// of columns. Never fused, in no profile.
#[inline(always)]
pub fn multiply<R: AddRows>(
    adder: R,
    vectors: &[f32],
    matrix: &[f32],
    [inner, columns]: [usize; 2],
    products: &mut [f32],
) {
    let Some(last) = columns.checked_sub(PART) else {
        return multiply_plainly(vectors, matrix, [inner, columns], products);
    };
    let group = R::GROUP.min(MULTIPLIED);
    let vectors = vectors.chunks(inner.saturating_mul(group).max(1));
    for (vectors, products) in vectors.zip(products.chunks_mut(columns.saturating_mul(group))) {
        let pairs = vectors.chunks_exact(inner.max(1)).zip(products.chunks_exact_mut(columns));
        let pairs = pairs.map(|(inputs, outputs)| Pair { inputs, outputs });
        let mut pairs: Vec<Pair<'_>, MULTIPLIED> = pairs.take(MULTIPLIED).collect();
        // The last columns of all; counting some of them once more changes nothing.
        for first in (0..last).step_by(PART).chain([last]) {
            let strip = Strip { tile: matrix, width: columns, first };
            add_strip::<Exact, R, 1>(adder, strip, first, &mut pairs, Around::NOTHING);
        }
    }
}

/// Most vectors that [`multiply`] works on together.
const MULTIPLIED: usize = 8;

/// As [`multiply`], without vectors of the processor.
#[inline(always)]
pub(super) fn multiply_plainly(
    vectors: &[f32],
    matrix: &[f32],
    [inner, columns]: [usize; 2],
    products: &mut [f32],
) {
    let rows = vectors.chunks_exact(inner.max(1)).zip(products.chunks_exact_mut(columns.max(1)));
    for (vector, sums) in rows {
        if columns < NARROW {
            sums.iter_mut().enumerate().for_each(|(column, sum)| {
                *sum = column_product(vector, matrix, [column, columns]);
            });
            continue;
        }
        sums.fill(0.0);
        for (input, row) in vector.iter().zip(matrix.chunks_exact(columns.max(1))) {
            for (sum, weight) in sums.iter_mut().zip(row) {
                *sum += input * weight;
            }
        }
    }
}

/// Columns of a matrix that is narrow: a row of its sums is no vector, and each of them is kept in a register.
const NARROW: usize = 8;

/// A vector times one column of a matrix of so many.
#[inline(always)]
fn column_product(vector: &[f32], matrix: &[f32], [column, columns]: [usize; 2]) -> f32 {
    let mut weights = matrix.get(column..).unwrap_or(&[]).iter().step_by(columns.max(1));
    let mut sum = 0.0;
    // Not zipped: how many weights there are would be divided for.
    for input in vector {
        sum += input * weights.next().unwrap_or(&0.0);
    }
    sum
}

/// As [`products`] for inputs of which about half or more are zero, which are left out: one vector after the other,
/// since each has its zeros elsewhere. Columns in front of `column` are done, and their weights taken off.
#[inline(always)]
pub fn sparse_products<A: Arithmetic>(
    weights: &[f32],
    pairs: &mut [Pair<'_>],
    around: Around<'_>,
    column: usize,
) {
    let Some(Pair { inputs, outputs }) = pairs.first() else { return };
    let (rows, columns) = (inputs.len(), outputs.len());
    let (mut weights, mut column) = (weights, column);
    while column < columns {
        let width = tile_width(columns - column);
        let Some(tile) = weights.split_off(..rows.saturating_mul(width)) else { return };
        for pair in pairs.iter_mut() {
            match width {
                64 => add_marked::<A, 64>(tile, column, pair, around),
                32 => add_marked::<A, 32>(tile, column, pair, around),
                16 => add_marked::<A, 16>(tile, column, pair, around),
                _ => add_marked::<A, 8>(tile, column, pair, around),
            }
        }
        column += width;
    }
}

/// Works on one tile for one vector: the rows of inputs that are not zero.
#[inline(always)]
fn add_marked<A: Arithmetic, const WIDTH: usize>(
    tile: &[f32],
    column: usize,
    pair: &mut Pair<'_>,
    around: Around<'_>,
) {
    let mut sums: [f32; WIDTH] = start(around, column);
    let (rows, _) = tile.as_chunks::<WIDTH>();
    for (inputs, rows) in pair.inputs.chunks(MARKED).zip(rows.chunks(MARKED)) {
        let mut marks = [[0; 2]];
        mark(inputs, &mut marks);
        let [[low, high]] = marks;
        let mut marks = u64::from(low) | u64::from(high) << 32;
        while marks != 0 {
            let index = marks.trailing_zeros() as usize;
            marks &= marks - 1;
            let (Some(input), Some(row)) = (inputs.get(index), rows.get(index)) else { break };
            add_row::<A, WIDTH>(&mut sums, *input, row);
        }
    }
    write(pair, column, finished(sums, around.relu));
}

/// Where the sums of some columns start.
#[inline(always)]
fn start<const COLUMNS: usize>(around: Around<'_>, column: usize) -> [f32; COLUMNS] {
    let bias = around.bias.and_then(|bias| bias.get(column..)?.first_chunk());
    bias.copied().unwrap_or([0.0; COLUMNS])
}

/// Works on a tile of eight columns, the last of a matrix, for some vectors at once: one alone waits for its additions.
#[inline(always)]
fn add_narrow<A: Arithmetic, const COUNT: usize>(
    tile: &[f32],
    column: usize,
    pairs: &mut [Pair<'_>; COUNT],
    around: Around<'_>,
) {
    let mut sums: [[f32; 8]; COUNT] = [start(around, column); COUNT];
    let inputs = pairs.each_ref().map(|pair| pair.inputs);
    for (index, row) in tile.as_chunks().0.iter().enumerate() {
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            add_row::<A, 8>(sums, inputs.get(index).copied().unwrap_or(0.0), row);
        }
    }
    for (pair, sums) in pairs.iter_mut().zip(sums) {
        write(pair, column, finished(sums, around.relu));
    }
}

/// Works on a strip, which starts at `column` of the outputs.
#[inline(always)]
fn add_strip<A: Arithmetic, R: AddRows, const PARTS: usize>(
    adder: R,
    strip: Strip<'_>,
    column: usize,
    pairs: &mut [Pair<'_>],
    around: Around<'_>,
) {
    match pairs.len() {
        1 => add_for::<A, R, PARTS, 1>(adder, strip, column, pairs, around),
        2 => add_for::<A, R, PARTS, 2>(adder, strip, column, pairs, around),
        3 => add_for::<A, R, PARTS, 3>(adder, strip, column, pairs, around),
        4 => add_for::<A, R, PARTS, 4>(adder, strip, column, pairs, around),
        5 => add_for::<A, R, PARTS, 5>(adder, strip, column, pairs, around),
        6 => add_for::<A, R, PARTS, 6>(adder, strip, column, pairs, around),
        7 => add_for::<A, R, PARTS, 7>(adder, strip, column, pairs, around),
        _ => add_for::<A, R, PARTS, 8>(adder, strip, column, pairs, around),
    }
}

/// As [`add_strip`] for a number of vectors that is known to the compiler, if the build works on them with
/// strips of this width.
#[inline(always)]
fn add_for<A: Arithmetic, R: AddRows, const PARTS: usize, const COUNT: usize>(
    adder: R,
    strip: Strip<'_>,
    column: usize,
    pairs: &mut [Pair<'_>],
    around: Around<'_>,
) {
    if COUNT > R::GROUP || PARTS > adder.parts::<A>(COUNT) {
        return;
    }
    let Some(pairs) = pairs.first_chunk_mut::<COUNT>() else { return };
    let mut starts = [[0.0; PART]; PARTS];
    for (start_at, first) in starts.iter_mut().zip((column..).step_by(PART)) {
        *start_at = start(around, first);
    }
    let inputs = pairs.each_ref().map(|pair| pair.inputs);
    let sums = adder.add_rows::<A, PARTS, COUNT>(strip, starts, inputs);
    for (sums, pair) in sums.iter().zip(pairs) {
        for (sums, first) in sums.iter().zip((column..).step_by(PART)) {
            write(pair, first, finished(*sums, around.relu));
        }
    }
}

#[inline(always)]
fn write<const COLUMNS: usize>(pair: &mut Pair<'_>, first: usize, sums: [f32; COLUMNS]) {
    let columns = pair.outputs.get_mut(first..);
    if let Some(columns) = columns.and_then(|columns| columns.first_chunk_mut()) {
        *columns = sums;
    }
}

/// [`AddRows::add_rows`] as every processor of the target runs it.
#[inline(always)]
pub(super) fn add_rows<A: Arithmetic, const PARTS: usize, const COUNT: usize>(
    strip: Strip<'_>,
    start: [[f32; PART]; PARTS],
    inputs: [&[f32]; COUNT],
) -> [[[f32; PART]; PARTS]; COUNT] {
    let mut sums = [start; COUNT];
    'rows: for (index, row) in strip.tile.chunks_exact(strip.width.max(1)).enumerate() {
        let Some(row) = row.get(strip.first..) else { break };
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            let Some(input) = inputs.get(index) else { break 'rows };
            for (sums, row) in sums.iter_mut().zip(row.as_chunks().0) {
                add_row::<A, PART>(sums, *input, row);
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Portable;
    use crate::kernels::product::product;
    use std::vec::Vec;

    #[test]
    fn several_vectors_give_the_bits_of_each_alone() {
        let number = |seed: usize| ((seed * 2_654_435_761) >> 7 & 0xffff) as f32 / 32_768.0 - 1.0;
        for (rows, columns) in [(5, 8), (9, 128), (33, 120), (7, 64), (128, 48)] {
            let weights: Vec<f32> = (0..rows * columns).map(number).collect();
            let bias: Vec<f32> = (0..columns).map(|index| number(index + 77)).collect();
            for count in 0..=15 {
                let inputs: Vec<f32> = (0..count * rows).map(|index| number(index + 5)).collect();
                for around in [Around::NOTHING, Around { bias: Some(&bias), relu: true }] {
                    let mut alone = std::vec![f32::NAN; count * columns];
                    let pairs = inputs.chunks(rows).zip(alone.chunks_mut(columns));
                    pairs.for_each(|(inputs, outputs)| {
                        product::<Exact>(&weights, inputs, around, outputs);
                    });
                    let mut together = std::vec![f32::NAN; count * columns];
                    let mut pairs: Vec<Pair<'_>> = inputs
                        .chunks(rows)
                        .zip(together.chunks_mut(columns))
                        .map(|(inputs, outputs)| Pair { inputs, outputs })
                        .collect();
                    products::<Exact, Portable<Exact>>(
                        Portable::new(),
                        &weights,
                        &mut pairs,
                        around,
                    );
                    assert_eq!(alone, together, "{count} vectors, {rows} x {columns}");
                }
            }
        }
    }
}
