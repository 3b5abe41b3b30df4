//! Matrix times vector, one input after the other, over weights stored in tiles.
//!
//! A matrix `[inputs, outputs]` stores its columns in tiles of 64, then at most one each of 32, 16 and 8; a tile
//! holds its columns of every input row, row after row. Outputs are padded with zeros to a multiple of 8.

use super::arithmetic::Arithmetic;
use super::mark::{MARKED, Marks};
use super::rows::Rows;
use crate::math::relu_all;

/// Columns of the widest tile.
pub const TILE: usize = 64;

/// `outputs` rounded up to a multiple of eight, the narrowest tile; at least eight, so that rows of padded
/// outputs can be counted without asking whether they have any.
pub const fn padded(outputs: usize) -> usize {
    match outputs.saturating_add(7) & !7 {
        0 => 8,
        padded => padded,
    }
}

/// The width of the tile that starts where `rest` padded columns remain.
pub const fn tile_width(rest: usize) -> usize {
    match rest {
        64.. => 64,
        32.. => 32,
        16.. => 16,
        _ => 8,
    }
}

/// What the sums of a product start from, and what happens to them at the end.
#[derive(Clone, Copy, Debug)]
pub struct Around<'a> {
    /// Where each output starts, as long as the padded outputs; none: at zero.
    pub bias: Option<&'a [f32]>,
    /// Whether a ReLU follows.
    pub relu: bool,
}

impl Around<'_> {
    /// Just the product.
    pub const NOTHING: Self = Self { bias: None, relu: false };
}

/// The inputs of a product of which only those that are not zero are looked at.
#[derive(Clone, Copy, Debug)]
pub struct Sparse<'a> {
    /// The first inputs.
    pub values: &'a [f32],
    /// Which of them are not zero.
    pub marks: &'a [Marks],
    /// The one input behind the values that is 1, if there is one.
    pub one: Option<usize>,
    /// All inputs, those behind the values included.
    pub count: usize,
}

/// Writes the product of `inputs` and a matrix to `outputs`, whose length is a multiple of eight.
#[inline(always)]
pub fn product<A: Arithmetic>(
    weights: &[f32],
    inputs: &[f32],
    around: Around<'_>,
    outputs: &mut [f32],
) {
    let mut tiles = Tiles::new(weights, inputs.len(), around, outputs);
    while let Some(tile) = tiles.next::<64>() {
        tile.add_all::<A>(inputs);
    }
    if let Some(tile) = tiles.next::<32>() {
        tile.add_all::<A>(inputs);
    }
    if let Some(tile) = tiles.next::<16>() {
        tile.add_all::<A>(inputs);
    }
    if let Some(tile) = tiles.next::<8>() {
        tile.add_all::<A>(inputs);
    }
}

/// As [`product`] for inputs of which only some are not zero.
#[inline(always)]
pub fn sparse_product<A: Arithmetic>(
    weights: &[f32],
    inputs: Sparse<'_>,
    around: Around<'_>,
    outputs: &mut [f32],
) {
    let mut tiles = Tiles::new(weights, inputs.count, around, outputs);
    while let Some(tile) = tiles.next::<64>() {
        tile.add_marked::<A>(&inputs);
    }
    if let Some(tile) = tiles.next::<32>() {
        tile.add_marked::<A>(&inputs);
    }
    if let Some(tile) = tiles.next::<16>() {
        tile.add_marked::<A>(&inputs);
    }
    if let Some(tile) = tiles.next::<8>() {
        tile.add_marked::<A>(&inputs);
    }
}

/// The sum of rows, each times its weight, as wide as a row: a multiple of eight.
#[inline(always)]
pub fn mix<A: Arithmetic>(weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
    let mut first = 0;
    let mut sums = sums;
    while let Some(sums) = sums.split_off_mut(..64) {
        mix_columns::<A, 64>(weights, rows, &mut first, sums);
    }
    while let Some(sums) = sums.split_off_mut(..32) {
        mix_columns::<A, 32>(weights, rows, &mut first, sums);
    }
    while let Some(sums) = sums.split_off_mut(..16) {
        mix_columns::<A, 16>(weights, rows, &mut first, sums);
    }
    while let Some(sums) = sums.split_off_mut(..8) {
        mix_columns::<A, 8>(weights, rows, &mut first, sums);
    }
}

/// The sums of some columns, the first of which is `first`.
#[inline(always)]
fn mix_columns<A: Arithmetic, const WIDTH: usize>(
    weights: &[f32],
    rows: Rows<'_>,
    first: &mut usize,
    sums: &mut [f32],
) {
    let columns = *first..*first + WIDTH;
    *first = columns.end;
    let mut mixed = [0.0; WIDTH];
    for (weight, slot) in weights.iter().zip(rows.slots) {
        let row = rows.row(*slot).get(columns.clone()).and_then(|row| row.first_chunk());
        let Some(row) = row else { return };
        add_row::<A, WIDTH>(&mut mixed, *weight, row);
    }
    if let Some(sums) = sums.first_chunk_mut() {
        *sums = mixed;
    }
}

/// The tiles of a matrix that are still to be worked on.
struct Tiles<'w, 'o> {
    weights: &'w [f32],
    rows: usize,
    bias: Option<&'w [f32]>,
    relu: bool,
    outputs: &'o mut [f32],
}

/// Weights of a tile, where its sums start, and where they go.
struct Tile<'w, 'o, const WIDTH: usize> {
    rows: &'w [[f32; WIDTH]],
    start: [f32; WIDTH],
    relu: bool,
    columns: &'o mut [f32; WIDTH],
}

impl<'w, 'o> Tiles<'w, 'o> {
    /// Takes `Around` apart: copied in one piece, its flag, just written, would have to be waited for.
    #[inline(always)]
    fn new(weights: &'w [f32], rows: usize, around: Around<'w>, outputs: &'o mut [f32]) -> Self {
        Self { weights, rows, bias: around.bias, relu: around.relu, outputs }
    }

    /// The next tile, unless it is narrower.
    #[inline(always)]
    fn next<const WIDTH: usize>(&mut self) -> Option<Tile<'w, 'o, WIDTH>> {
        let columns = self.outputs.split_off_mut(..WIDTH)?.first_chunk_mut()?;
        let rows = split_off_rows(&mut self.weights, self.rows)?;
        let start = match &mut self.bias {
            Some(bias) => *bias.split_off(..WIDTH)?.first_chunk()?,
            None => [0.0; WIDTH],
        };
        Some(Tile { rows, start, relu: self.relu, columns })
    }
}

/// Takes the rows of a tile off the weights.
#[inline(always)]
fn split_off_rows<'w, const WIDTH: usize>(
    weights: &mut &'w [f32],
    rows: usize,
) -> Option<&'w [[f32; WIDTH]]> {
    let tile = weights.split_off(..rows.saturating_mul(WIDTH))?;
    Some(tile.as_chunks().0)
}

impl<const WIDTH: usize> Tile<'_, '_, WIDTH> {
    #[inline(always)]
    fn add_all<A: Arithmetic>(self, inputs: &[f32]) {
        let mut sums = self.start;
        // Several a turn, so that counting does not cost a fifth of it.
        let (eight_inputs, last_inputs) = inputs.as_chunks::<8>();
        let (eight_rows, last_rows) = self.rows.as_chunks::<8>();
        for (inputs, rows) in eight_inputs.iter().zip(eight_rows) {
            for (input, row) in inputs.iter().zip(rows) {
                add_row::<A, WIDTH>(&mut sums, *input, row);
            }
        }
        for (input, row) in last_inputs.iter().zip(last_rows) {
            add_row::<A, WIDTH>(&mut sums, *input, row);
        }
        *self.columns = finished(sums, self.relu);
    }

    #[inline(always)]
    fn add_marked<A: Arithmetic>(self, inputs: &Sparse<'_>) {
        let mut sums = self.start;
        let count = inputs.values.len();
        let rows = self.rows.get(..count).unwrap_or(&[]);
        for (first, [low, high]) in (0..count).step_by(MARKED).zip(inputs.marks) {
            let mut marks = u64::from(*low) | u64::from(*high) << 32;
            while marks != 0 {
                let index: usize = first + marks.trailing_zeros() as usize;
                marks &= marks - 1;
                let (Some(value), Some(row)) = (inputs.values.get(index), rows.get(index)) else {
                    break;
                };
                add_row::<A, WIDTH>(&mut sums, *value, row);
            }
        }
        if let Some(row) = inputs.one.and_then(|index| self.rows.get(index)) {
            add_row::<A, WIDTH>(&mut sums, 1.0, row);
        }
        *self.columns = finished(sums, self.relu);
    }
}

#[inline(always)]
pub(super) fn add_row<A: Arithmetic, const WIDTH: usize>(
    sums: &mut [f32; WIDTH],
    input: f32,
    row: &[f32; WIDTH],
) {
    for (sum, weight) in sums.iter_mut().zip(row) {
        *sum = A::multiply_add(*sum, input, *weight);
    }
}

#[inline(always)]
pub(super) fn finished<const WIDTH: usize>(
    mut sums: [f32; WIDTH],
    relu_follows: bool,
) -> [f32; WIDTH] {
    if relu_follows {
        relu_all(&mut sums);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::arithmetic::Exact;
    use crate::kernels::mark::mark;
    use std::vec;
    use std::vec::Vec;

    /// Any numbers of both signs, zeros among them.
    fn numbers(count: usize, seed: u32) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
        (0..count)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if state >> 30 == 0 { 0.0 } else { (state >> 8) as f32 / 8_388_608.0 - 1.0 }
            })
            .collect()
    }

    #[test]
    fn tiles_cover_every_width_in_order() {
        for outputs in (8..=256).step_by(8) {
            let (inputs, mut sums) = (numbers(5, 1), vec![f32::NAN; outputs]);
            let (weights, bias) = (numbers(5 * outputs, 2), numbers(outputs, 7));
            let around = Around { bias: Some(&bias), relu: false };
            product::<Exact>(&weights, &inputs, around, &mut sums);
            let (mut start, mut want) = (0, bias.clone());
            while start < outputs {
                let width = tile_width(outputs - start);
                for (i, input) in inputs.iter().enumerate() {
                    for j in 0..width {
                        want[start + j] += input * weights[start * 5 + i * width + j];
                    }
                }
                start += width;
            }
            assert_eq!(sums, want, "{outputs} outputs");
            product::<Exact>(&weights, &inputs, Around { relu: true, ..around }, &mut sums);
            relu_all(&mut want);
            assert_eq!(sums, want, "{outputs} outputs, ReLU");
        }
    }

    #[test]
    fn mixes_rows_of_every_width() {
        for width in (8..=256).step_by(8) {
            let (weights, rows) = (numbers(7, 5), numbers(7 * width, 6));
            let mut sums = vec![f32::NAN; width];
            mix::<Exact>(&weights, Rows::first(&rows, width, 7), &mut sums);
            for (column, sum) in sums.iter().enumerate() {
                let terms = weights.iter().zip(rows.chunks(width));
                let want = terms.fold(0.0, |sum, (weight, row)| sum + weight * row[column]);
                assert_eq!(*sum, want, "width {width}, column {column}");
            }
        }
    }

    #[test]
    fn leaving_out_zeros_keeps_every_bit() {
        for (inputs, outputs) in [(70, 128), (128, 64), (9, 8), (64, 16), (33, 120)] {
            let (weights, values) = (numbers(inputs * outputs, 3), numbers(inputs, 4));
            let (mut dense, mut sparse) = (vec![0.0; outputs], vec![0.0; outputs]);
            let bias = vec![0.25; outputs];
            let around = Around { bias: Some(&bias), relu: true };
            let mut marks = vec![[0; 2]; inputs.div_ceil(64)];
            mark(&values, &mut marks);
            let sparse_inputs = Sparse { values: &values, marks: &marks, one: None, count: inputs };
            product::<Exact>(&weights, &values, around, &mut dense);
            sparse_product::<Exact>(&weights, sparse_inputs, around, &mut sparse);
            let bits = |sums: &[f32]| sums.iter().map(|sum| sum.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&dense), bits(&sparse));
        }
    }
}
