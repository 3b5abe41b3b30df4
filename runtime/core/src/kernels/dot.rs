//! Sums and dot products in 16 lanes that a fixed tree joins.

use super::arithmetic::Arithmetic;
use super::rows::Rows;

/// Lanes of a sum: element i goes to lane i mod 16.
pub const LANES: usize = 16;

/// Rows that are worked on together.
pub const ROWS: usize = 4;

/// The dot products of one vector with rows as wide as it. `products` has one place per row, and room up to a
/// multiple of four; what it has beyond the rows is overwritten with anything.
#[inline(always)]
pub fn dots(
    vector: &[f32],
    rows: Rows<'_>,
    products: &mut [f32],
    four_dots: impl Fn(&[f32], [&[f32]; ROWS]) -> [f32; ROWS],
) {
    let (groups, _) = products.as_chunks_mut::<ROWS>();
    for (slots, products) in rows.slots.chunks(ROWS).zip(groups) {
        // Where rows end, the last one stands for those that are missing.
        let row =
            |index: usize| slots.get(index).or(slots.last()).map_or(&[][..], |s| rows.row(*s));
        *products = four_dots(vector, [row(0), row(1), row(2), row(3)]);
    }
}

/// The dot products of a vector with four rows as long as it.
#[inline(always)]
pub fn four_dots<A: Arithmetic>(vector: &[f32], rows: [&[f32]; ROWS]) -> [f32; ROWS] {
    let [r0, r1, r2, r3] = rows.map(|row| row.as_chunks::<LANES>());
    let (chunks, rest) = vector.as_chunks::<LANES>();
    let mut lanes = [[0.0; LANES]; ROWS];
    let rows = r0.0.iter().zip(r1.0).zip(r2.0).zip(r3.0);
    for (chunk, (((c0, c1), c2), c3)) in chunks.iter().zip(rows) {
        for (lanes, row) in lanes.iter_mut().zip([c0, c1, c2, c3]) {
            for ((lane, a), b) in lanes.iter_mut().zip(chunk).zip(row) {
                *lane = A::multiply_add(*lane, *a, *b);
            }
        }
    }
    if !rest.is_empty() {
        for (lanes, row) in lanes.iter_mut().zip([r0.1, r1.1, r2.1, r3.1]) {
            for ((lane, a), b) in lanes.iter_mut().zip(rest).zip(row) {
                *lane = A::multiply_add(*lane, *a, *b);
            }
        }
    }
    lanes.map(join)
}

/// The sum of the squares of all values.
#[inline(always)]
pub fn sum_of_squares(values: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    for chunk in values.chunks(LANES) {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value * value;
        }
    }
    join(lanes)
}

/// The sum of all values.
#[inline(always)]
pub fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    for (lane, value) in lanes.iter_mut().zip(rest) {
        *lane += value;
    }
    join(lanes)
}

/// Adds lanes j and j + 8, then neighbours, then neighbours again, then the two halves.
#[inline(always)]
pub(super) fn join(lanes: [f32; LANES]) -> f32 {
    let [a0, a1, a2, a3, a4, a5, a6, a7, b0, b1, b2, b3, b4, b5, b6, b7] = lanes;
    let low = ((a0 + b0) + (a1 + b1)) + ((a2 + b2) + (a3 + b3));
    let high = ((a4 + b4) + (a5 + b5)) + ((a6 + b6) + (a7 + b7));
    low + high
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::arithmetic::{Exact, Fused};
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn covers_whole_chunks_and_the_rest() {
        for len in [8, 16, 24, 40, 128] {
            for rows in 1..10 {
                let vector: Vec<f32> = (1..=len).map(|i| i as f32).collect();
                let factors = (0..rows).flat_map(|row| vec![(row + 1) as f32; len]);
                let factors: Vec<f32> = factors.collect();
                let total = (len * (len + 1) / 2) as f32;
                let want: Vec<f32> = (0..rows).map(|row| (row + 1) as f32 * total).collect();
                let mut products = vec![f32::NAN; 12];
                dots(&vector, Rows::first(&factors, len, rows), &mut products, four_dots::<Exact>);
                assert_eq!(products[..rows], want);
                dots(&vector, Rows::first(&factors, len, rows), &mut products, four_dots::<Fused>);
                assert_eq!(products[..rows], want);
            }
        }
    }

    #[test]
    fn sums_everything() {
        for len in [0, 1, 8, 15, 16, 24, 40, 128] {
            let values: Vec<f32> = (1..=len).map(|i| i as f32).collect();
            assert_eq!(sum(&values), (len * (len + 1) / 2) as f32);
        }
    }
}
