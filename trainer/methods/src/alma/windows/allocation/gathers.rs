//! Vectors picked from matrices by lists of rows, and what is done with them.

use sortie_nn::layers::vectors::{add_scaled, dots};
use sortie_nn::layers::wide::{Work, run_widest};

/// Copies the rows of `from` that the list names.
pub(super) fn gather(width: usize, from: &[f32], rows: &[u32], out: &mut [f32]) {
    for (row, out) in rows.iter().zip(out.chunks_exact_mut(width)) {
        out.copy_from_slice(&from[*row as usize * width..][..width]);
    }
}

/// Adds row after row of `from` to the rows of `out` that the list names.
pub(super) fn scatter_add(width: usize, from: &[f32], rows: &[u32], out: &mut [f32]) {
    run_widest(ScatterAdd { width, from, rows, out });
}

struct ScatterAdd<'a> {
    width: usize,
    from: &'a [f32],
    rows: &'a [u32],
    out: &'a mut [f32],
}

impl Work for ScatterAdd<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (row, from) in self.rows.iter().zip(self.from.chunks_exact(self.width)) {
            add_scaled(&mut self.out[*row as usize * self.width..][..self.width], 1.0, from);
        }
    }
}

/// Writes the dot product of each pair of rows.
pub(super) fn dot_pairs(
    width: usize,
    left: &[f32],
    right: &[f32],
    pairs: &[(u32, u32)],
    out: &mut [f32],
) {
    run_widest(DotPairs { width, left, right, pairs, out });
}

struct DotPairs<'a> {
    width: usize,
    left: &'a [f32],
    right: &'a [f32],
    pairs: &'a [(u32, u32)],
    out: &'a mut [f32],
}

impl Work for DotPairs<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { width, .. } = self;
        for ((left, right), out) in self.pairs.iter().zip(self.out) {
            let left = &self.left[*left as usize * width..][..width];
            let right = &self.right[*right as usize * width..][..width];
            // Four quarters at once are faster than one long sum.
            let whole = width / 4 * 4;
            let mut quarters = [0.0; 4];
            dots(&left[..whole], &right[..whole], &mut quarters);
            *out = (quarters[0] + quarters[1]) + (quarters[2] + quarters[3]);
            for (a, b) in left[whole..].iter().zip(&right[whole..]) {
                *out += a * b;
            }
        }
    }
}

/// A dot product's slope, shared out to the two vectors: `(left, right, slope)`.
pub(super) type Slope = (u32, u32, f32);

/// The way back through [`dot_pairs`]: adds to the gradients of both sides.
pub(super) fn dot_pairs_backward(
    width: usize,
    left: &[f32],
    right: &[f32],
    slopes: &[Slope],
    (d_left, d_right): (&mut [f32], &mut [f32]),
) {
    run_widest(DotPairsBackward { width, left, right, slopes, d_left, d_right });
}

struct DotPairsBackward<'a> {
    width: usize,
    left: &'a [f32],
    right: &'a [f32],
    slopes: &'a [Slope],
    d_left: &'a mut [f32],
    d_right: &'a mut [f32],
}

impl Work for DotPairsBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.width;
        for (left, right, slope) in self.slopes {
            let (left, right) = (*left as usize * width, *right as usize * width);
            add_scaled(&mut self.d_left[left..][..width], *slope, &self.right[right..][..width]);
            add_scaled(&mut self.d_right[right..][..width], *slope, &self.left[left..][..width]);
        }
    }
}

/// Adds three rows, `(target, parent, product, update)`: `out[target] = out[parent] + product + update`.
pub(super) type Sum = (u32, u32, u32, u32);

/// Writes new rows of `out` as sums of an older row, one of `products` and one of `updates`.
pub(super) fn add_three(
    width: usize,
    sums: &[Sum],
    products: &[f32],
    updates: &[f32],
    out: &mut [f32],
) {
    run_widest(AddThree { width, sums, products, updates, out });
}

struct AddThree<'a> {
    width: usize,
    sums: &'a [Sum],
    products: &'a [f32],
    updates: &'a [f32],
    out: &'a mut [f32],
}

impl Work for AddThree<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.width;
        for (target, parent, product, update) in self.sums {
            let at = |row: u32| row as usize * width;
            let (older, newer) = self.out.split_at_mut(at(*target));
            let target = &mut newer[..width];
            target.copy_from_slice(&older[at(*parent)..][..width]);
            add_scaled(target, 1.0, &self.products[at(*product)..][..width]);
            add_scaled(target, 1.0, &self.updates[at(*update)..][..width]);
        }
    }
}

/// Adds `d` to `gradient` where `value`, which was rectified, is positive.
pub(super) fn add_rectified(value: &[f32], d: &[f32], gradient: &mut [f32]) {
    run_widest(AddRectified { value, d, gradient });
}

struct AddRectified<'a> {
    value: &'a [f32],
    d: &'a [f32],
    gradient: &'a mut [f32],
}

impl Work for AddRectified<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for ((value, d), gradient) in self.value.iter().zip(self.d).zip(self.gradient) {
            *gradient += if *value > 0.0 { *d } else { 0.0 };
        }
    }
}
