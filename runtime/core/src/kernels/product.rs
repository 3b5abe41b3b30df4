//! Matrix times vector, one input after the other, over weights stored in tiles.
//!
//! A matrix `[inputs, outputs]` stores its columns in tiles of 64, then at most one each of 32, 16 and 8; a tile
//! holds its columns of every input row, row after row. Outputs are padded with zeros to a multiple of 8.

use super::nonzero::Nonzero;

/// Columns of the widest tile.
pub const TILE: usize = 64;

/// `outputs` rounded up to a multiple of eight, the narrowest tile.
pub const fn padded(outputs: usize) -> usize {
    outputs.saturating_add(7) & !7
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

/// Adds the product of every input with its row to `sums`, whose length is a multiple of eight.
#[inline(always)]
pub fn add_product(weights: &[f32], inputs: &[f32], sums: &mut [f32]) {
    let (mut weights, mut sums) = (weights, sums);
    while !sums.is_empty() {
        let (block, columns);
        (block, weights, columns, sums) = match next_tile(weights, inputs.len(), sums) {
            Some(parts) => parts,
            None => return,
        };
        match columns.len() {
            64 => tile::<64>(block, inputs, columns),
            32 => tile::<32>(block, inputs, columns),
            16 => tile::<16>(block, inputs, columns),
            _ => tile::<8>(block, inputs, columns),
        }
    }
}

/// As [`add_product`] for a matrix of `rows` inputs of which only those in `inputs` are not zero.
#[inline(always)]
pub fn add_sparse_product(weights: &[f32], rows: usize, inputs: &[Nonzero], sums: &mut [f32]) {
    let (mut weights, mut sums) = (weights, sums);
    while !sums.is_empty() {
        let (block, columns);
        (block, weights, columns, sums) = match next_tile(weights, rows, sums) {
            Some(parts) => parts,
            None => return,
        };
        match columns.len() {
            64 => sparse_tile::<64>(block, inputs, columns),
            32 => sparse_tile::<32>(block, inputs, columns),
            16 => sparse_tile::<16>(block, inputs, columns),
            _ => sparse_tile::<8>(block, inputs, columns),
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
    for (weight, row) in weights.iter().zip(rows.chunks_exact(width)) {
        let Some(row) = row.get(start..).and_then(|row| row.first_chunk::<WIDTH>()) else { return };
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += weight * value;
        }
    }
    *columns = sums;
}

/// A tile's weights and columns, each with what follows.
type Tile<'w, 's> = (&'w [f32], &'w [f32], &'s mut [f32], &'s mut [f32]);

#[inline(always)]
fn next_tile<'w, 's>(weights: &'w [f32], rows: usize, sums: &'s mut [f32]) -> Option<Tile<'w, 's>> {
    let width = tile_width(sums.len());
    let (block, weights) = weights.split_at_checked(rows.checked_mul(width)?)?;
    let (columns, sums) = sums.split_at_mut_checked(width)?;
    Some((block, weights, columns, sums))
}

#[inline(always)]
fn tile<const WIDTH: usize>(block: &[f32], inputs: &[f32], columns: &mut [f32]) {
    let Ok(columns) = <&mut [f32; WIDTH]>::try_from(columns) else { return };
    let (rows, _) = block.as_chunks::<WIDTH>();
    // A local copy lets the sums stay in registers.
    let mut sums = *columns;
    for (input, row) in inputs.iter().zip(rows) {
        for (sum, weight) in sums.iter_mut().zip(row) {
            *sum += input * weight;
        }
    }
    *columns = sums;
}

#[inline(always)]
fn sparse_tile<const WIDTH: usize>(block: &[f32], inputs: &[Nonzero], columns: &mut [f32]) {
    let Ok(columns) = <&mut [f32; WIDTH]>::try_from(columns) else { return };
    let (rows, _) = block.as_chunks::<WIDTH>();
    let mut sums = *columns;
    for &[index, bits] in inputs {
        let input = f32::from_bits(bits);
        if let Some(row) = rows.get(index as usize) {
            for (sum, weight) in sums.iter_mut().zip(row) {
                *sum += input * weight;
            }
        }
    }
    *columns = sums;
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
            let (inputs, mut sums) = (numbers(5, 1), vec![0.5; outputs]);
            let weights = numbers(5 * outputs, 2);
            add_product(&weights, &inputs, &mut sums);
            let (mut start, mut want) = (0, vec![0.5; outputs]);
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
            let (mut dense, mut sparse) = (vec![0.25; outputs], vec![0.25; outputs]);
            let mut list = vec![[0; 2]; inputs];
            let count = collect(&values, &mut list);
            assert!(count < inputs);
            add_product(&weights, &values, &mut dense);
            add_sparse_product(&weights, inputs, &list[..count], &mut sparse);
            let bits = |sums: &[f32]| sums.iter().map(|sum| sum.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&dense), bits(&sparse));
        }
    }
}
