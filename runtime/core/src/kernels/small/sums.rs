//! Sums of products as every processor computes them.
#![cfg_attr(all(feature = "dsp", target_arch = "arm"), allow(dead_code))]

use super::parts::{Columns, List, Listed, PART, Part};
use crate::kernels::int8::{Inputs, IntegerRows, PAIRS, Pair};

/// The sums of a part's columns, of all pairs of inputs; rows without an input and inputs without a row are left out.
#[inline(always)]
pub(super) fn of_all(rows: &[[Part; 2]], half: usize, inputs: &[Inputs], sums: &mut [i32; PART]) {
    *sums = [0; PART];
    let rows = rows.as_chunks::<PAIRS>().0.as_flattened();
    for (row, pair) in rows.iter().zip(inputs.as_flattened()) {
        if let (Some(columns), true) = (row.get(half), *pair != [0; 2]) {
            add(sums, columns, *pair);
        }
    }
}

/// The same of listed pairs; none where a row is missing.
#[inline(always)]
pub(super) fn of_listed(
    rows: &[[Part; 2]],
    half: usize,
    list: &List,
    sums: &mut [i32; PART],
) -> Option<()> {
    *sums = [0; PART];
    for Listed { row, pair } in list.pairs() {
        add(sums, rows.get(*row as usize)?.get(half)?, *pair);
    }
    Some(())
}

/// Adds the products of a pair of inputs to the sums of eight columns.
#[inline(always)]
pub(super) fn add(sums: &mut [i32; PART], columns: &Part, [first, second]: Pair) {
    let (first, second) = (i32::from(first), i32::from(second));
    for ([a, b], columns) in sums.as_chunks_mut::<2>().0.iter_mut().zip(columns) {
        let [a0, a1, b0, b1] = of_columns(*columns);
        // Never wraps, see `input_max`.
        *a = a.wrapping_add(a0 * first + a1 * second);
        *b = b.wrapping_add(b0 * first + b1 * second);
    }
}

/// Two weights of a column, then two of the next.
#[inline(always)]
fn of_columns(columns: Columns) -> [i32; 4] {
    let [a, b, c, d] = columns.to_le_bytes().map(|byte| i32::from(byte as i8));
    if cfg!(all(feature = "dsp", target_arch = "arm")) { [a, c, b, d] } else { [a, b, c, d] }
}

/// The dot product of two vectors.
#[inline(always)]
pub(super) fn dot(vector: &[i16], row: &[i16]) -> i32 {
    // Never wraps, see `row_max`.
    let add = |sum: i32, (a, b): (&i16, &i16)| sum.wrapping_add(i32::from(*a) * i32::from(*b));
    vector.iter().zip(row).fold(0, add)
}

/// The weighted sums of rows, of as many columns as there are sums.
#[inline(always)]
pub(super) fn mix(weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
    for (part, sums) in sums.as_chunks_mut::<PART>().0.iter_mut().enumerate() {
        let mut mixed = [0_i32; PART];
        for (slot, weight) in rows.slots.iter().zip(weights) {
            let row = rows.row(*slot).0.get(part * PART..);
            let Some(columns) = row.and_then(|row| row.first_chunk::<PART>()) else { continue };
            for (sum, column) in mixed.iter_mut().zip(columns) {
                // Never wraps, see `mixing_max`.
                *sum = sum.wrapping_add(i32::from(*weight) * i32::from(*column));
            }
        }
        *sums = mixed;
    }
}
