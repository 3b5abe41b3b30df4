//! Matrix times vector, one input after the other, over weights stored in tiles.
//!
//! A matrix `[inputs, outputs]` stores its columns in tiles of 64, then at most one each of 32, 16 and 8; a tile
//! holds its columns of every input row, row after row. Outputs are padded with zeros to a multiple of 8.

use super::nonzero::Nonzero;
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

/// Writes the product of `inputs` and a matrix to `outputs`, whose length is a multiple of eight.
#[inline(always)]
pub fn product(weights: &[f32], inputs: &[f32], around: Around<'_>, outputs: &mut [f32]) {
    let mut tiles = Tiles::new(weights, inputs.len(), around, outputs);
    while let Some((block, start, columns)) = tiles.next() {
        match columns.len() {
            64 => tile::<64>(block, inputs, start, around.relu, columns),
            32 => tile::<32>(block, inputs, start, around.relu, columns),
            16 => tile::<16>(block, inputs, start, around.relu, columns),
            _ => tile::<8>(block, inputs, start, around.relu, columns),
        }
    }
}

/// As [`product`] for a matrix of `rows` inputs of which only those in `inputs` are not zero.
#[inline(always)]
pub fn sparse_product(
    weights: &[f32],
    rows: usize,
    inputs: &[Nonzero],
    around: Around<'_>,
    outputs: &mut [f32],
) {
    let mut tiles = Tiles::new(weights, rows, around, outputs);
    while let Some((block, start, columns)) = tiles.next() {
        match columns.len() {
            64 => sparse_tile::<64>(block, inputs, start, around.relu, columns),
            32 => sparse_tile::<32>(block, inputs, start, around.relu, columns),
            16 => sparse_tile::<16>(block, inputs, start, around.relu, columns),
            _ => sparse_tile::<8>(block, inputs, start, around.relu, columns),
        }
    }
}

/// The sum of rows, each times its weight, in tiles of columns; `rows` is as wide as `sums`.
#[inline(always)]
pub fn mix(weights: &[f32], rows: &[f32], sums: &mut [f32]) {
    let width = sums.len();
    let (mut start, mut sums) = (0, sums);
    while let Some((columns, rest)) = sums.split_at_mut_checked(tile_width(sums.len())) {
        if columns.is_empty() {
            return;
        }
        let next = start + columns.len();
        match columns.len() {
            64 => mix_tile::<64>(weights, rows, width, start, columns),
            32 => mix_tile::<32>(weights, rows, width, start, columns),
            16 => mix_tile::<16>(weights, rows, width, start, columns),
            _ => mix_tile::<8>(weights, rows, width, start, columns),
        }
        (start, sums) = (next, rest);
    }
}

#[inline(always)]
fn mix_tile<const WIDTH: usize>(
    weights: &[f32],
    rows: &[f32],
    width: usize,
    start: usize,
    columns: &mut [f32],
) {
    let Ok(columns) = <&mut [f32; WIDTH]>::try_from(columns) else { return };
    let mut sums = [0.0; WIDTH];
    for (weight, row) in weights.iter().zip(rows.chunks_exact(width.max(1))) {
        let Some(row) = row.get(start..).and_then(|row| row.first_chunk::<WIDTH>()) else { return };
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += weight * value;
        }
    }
    *columns = sums;
}

/// The tiles of a matrix, one after the other.
struct Tiles<'w, 'o> {
    weights: &'w [f32],
    rows: usize,
    bias: Option<&'w [f32]>,
    outputs: &'o mut [f32],
}

/// Weights, bias and outputs of one tile.
type Tile<'w, 'o> = (&'w [f32], Option<&'w [f32]>, &'o mut [f32]);

impl<'w, 'o> Tiles<'w, 'o> {
    #[inline(always)]
    fn new(weights: &'w [f32], rows: usize, around: Around<'w>, outputs: &'o mut [f32]) -> Self {
        Self { weights, rows, bias: around.bias, outputs }
    }

    #[inline(always)]
    fn next(&mut self) -> Option<Tile<'w, 'o>> {
        if self.outputs.is_empty() {
            return None;
        }
        let width = tile_width(self.outputs.len());
        let (block, weights) = self.weights.split_at_checked(self.rows.checked_mul(width)?)?;
        let outputs = core::mem::take(&mut self.outputs);
        let (columns, outputs) = outputs.split_at_mut_checked(width)?;
        let (start, bias) = match self.bias {
            Some(bias) => {
                let (start, bias) = bias.split_at_checked(width)?;
                (Some(start), Some(bias))
            }
            None => (None, None),
        };
        (self.weights, self.outputs, self.bias) = (weights, outputs, bias);
        Some((block, start, columns))
    }
}

#[inline(always)]
fn tile<const WIDTH: usize>(
    block: &[f32],
    inputs: &[f32],
    start: Option<&[f32]>,
    relu: bool,
    columns: &mut [f32],
) {
    let (rows, _) = block.as_chunks::<WIDTH>();
    let mut sums = first_sums::<WIDTH>(start);
    for (input, row) in inputs.iter().zip(rows) {
        for (sum, weight) in sums.iter_mut().zip(row) {
            *sum += input * weight;
        }
    }
    finish(sums, relu, columns);
}

#[inline(always)]
fn sparse_tile<const WIDTH: usize>(
    block: &[f32],
    inputs: &[Nonzero],
    start: Option<&[f32]>,
    relu: bool,
    columns: &mut [f32],
) {
    let (rows, _) = block.as_chunks::<WIDTH>();
    let mut sums = first_sums::<WIDTH>(start);
    for &[index, bits] in inputs {
        let input = f32::from_bits(bits);
        if let Some(row) = rows.get(index as usize) {
            for (sum, weight) in sums.iter_mut().zip(row) {
                *sum += input * weight;
            }
        }
    }
    finish(sums, relu, columns);
}

/// A local copy, so that the sums of a tile stay in registers.
#[inline(always)]
fn first_sums<const WIDTH: usize>(start: Option<&[f32]>) -> [f32; WIDTH] {
    start.and_then(|start| start.first_chunk()).copied().unwrap_or([0.0; WIDTH])
}

#[inline(always)]
fn finish<const WIDTH: usize>(mut sums: [f32; WIDTH], relu: bool, columns: &mut [f32]) {
    if relu {
        relu_all(&mut sums);
    }
    if let Some(columns) = columns.first_chunk_mut::<WIDTH>() {
        *columns = sums;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::nonzero::collect;
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
            product(&weights, &inputs, around, &mut sums);
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
            product(&weights, &inputs, Around { relu: true, ..around }, &mut sums);
            relu_all(&mut want);
            assert_eq!(sums, want, "{outputs} outputs, ReLU");
        }
    }

    #[test]
    fn mixes_rows_of_every_width() {
        for width in (8..=256).step_by(8) {
            let (weights, rows) = (numbers(7, 5), numbers(7 * width, 6));
            let mut sums = vec![f32::NAN; width];
            mix(&weights, &rows, &mut sums);
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
            let mut list = vec![[0; 2]; inputs];
            let count = collect(&values, &mut list);
            assert!(count < inputs);
            product(&weights, &values, around, &mut dense);
            sparse_product(&weights, inputs, &list[..count], around, &mut sparse);
            let bits = |sums: &[f32]| sums.iter().map(|sum| sum.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&dense), bits(&sparse));
        }
    }
}
