//! Products of int8 weights where there are no vectors: eight columns at a time.

use core::slice::{Iter, IterMut};

use zerocopy::{FromBytes, IntoBytes, transmute};

use super::Small;
#[cfg(all(feature = "dsp", target_arch = "arm"))]
use super::dsp::{dot, mix, of_all, of_listed};
use super::parts::{List, PART, Part};
use super::sums::add;
#[cfg(not(all(feature = "dsp", target_arch = "arm")))]
use super::sums::{dot, mix, of_all, of_listed};
use crate::kernels::int8::patches::AddIntegerRuns;
use crate::kernels::int8::{
    Count, Int8Kernels, Int8PatchLayer, IntegerRows, IntegerTiles, Matrix, PAIRS, Pair, Reach, Row,
    STRIP, Scale, SparseVector, Vector, add_runs, narrow,
};
use crate::kernels::patches::{Runs, convolve};
use crate::math::relu;

impl<A, const SKIPS: bool> Int8Kernels for Small<A, SKIPS> {
    #[inline(never)]
    fn quantise(self, values: &[f32], reach: Reach, integers: &mut [i16]) -> Option<Scale> {
        let magnitude = |value: &f32| value.to_bits() & 0x7fff_ffff;
        let (fours, rest) = values.as_chunks::<4>();
        let mut largest = rest.iter().map(magnitude).fold(0, u32::max);
        for four in fours {
            largest = four.iter().map(magnitude).fold(largest, u32::max);
        }
        let scale = Scale::reaching(largest, reach)?;
        let integer = |value: &f32| match value.to_bits() {
            0 if SKIPS => 0,
            _ => scale.integer(*value),
        };
        let (to, behind) = integers.split_at_mut_checked(values.len())?;
        let (to_fours, to_rest) = to.as_chunks_mut::<4>();
        for (to, four) in to_fours.iter_mut().zip(fours) {
            *to = four.each_ref().map(integer);
        }
        for (to, value) in to_rest.iter_mut().zip(rest) {
            *to = integer(value);
        }
        behind.fill(0);
        Some(scale)
    }

    #[inline(never)]
    fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
        let all = halves(matrix.rows);
        for vector in vectors {
            let strips = all.chunks_exact((matrix.groups * PAIRS).max(1));
            let (mut parts, inputs) =
                (Parts::of(matrix, vector.step, vector.outputs), vector.inputs);
            let mut sums = [0; PART];
            for rows in strips {
                for half in 0..2 {
                    of_all(rows, half, inputs, &mut sums);
                    parts.fill(&sums);
                }
            }
        }
    }

    #[inline(never)]
    fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: SparseVector<'_>) -> Option<()> {
        let reach = vector.reach();
        let SparseVector { values, one, integers, outputs } = vector;
        let scale = self.quantise(values, reach, integers)?;
        if let Some(place) = one.and_then(|one| integers.get_mut(one)) {
            *place = scale.integer(1.0);
        }
        let strips = outputs.len().div_ceil(STRIP);
        let pairs: &[Pair] = integers.as_chunks().0;
        // What is behind those of the matrix is zero.
        let pairs = pairs.get(..matrix.groups * PAIRS).unwrap_or(pairs);
        let mut list = List::EMPTY;
        let rest = list.fill(pairs, strips);
        let mut parts = Parts::of(matrix, scale.step, outputs);
        let (all, mut sums) = (halves(matrix.rows), [0; PART]);
        for strip in 0..strips {
            let rows = all.get(strip..)?;
            for half in 0..2 {
                of_listed(rows, half, &list, &mut sums)?;
                if !rest.is_empty() {
                    add_rest((rows, half), rest, (pairs.len(), strips), &mut sums);
                }
                parts.fill(&sums);
            }
        }
        Some(())
    }

    #[inline(never)]
    fn int8_convolve(
        self,
        layer: &Int8PatchLayer<'_>,
        integers: &[i16],
        step: f32,
        to: &mut [f32],
    ) {
        let tiles = IntegerTiles::of(self, layer, (integers, step));
        convolve::<1, 1>(&tiles, (layer.patches, layer.outputs), to);
    }

    #[inline(never)]
    fn int8_dots(self, vector: &[i16], step: f32, rows: IntegerRows<'_>, products: &mut [f32]) {
        for (slot, product) in rows.slots.iter().zip(products) {
            let (row, row_step) = rows.row(*slot);
            *product = dot(vector, row) as f32 * (step * row_step);
        }
    }

    #[inline(never)]
    fn int8_mix(self, weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
        mix(weights, rows, sums);
    }

    #[inline(never)]
    fn narrow(self, sums: &[i32], most: u16, integers: &mut [i16]) -> f32 {
        narrow(sums, most, integers)
    }
}

impl<A, const SKIPS: bool> AddIntegerRuns for Small<A, SKIPS> {
    #[inline(always)]
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        add_runs(rows, runs, at, |sums, row, pair| {
            let halves: [Part; 2] = transmute!(*row);
            for (sums, columns) in sums.as_chunks_mut().0.iter_mut().zip(&halves) {
                add(sums, columns, pair);
            }
        })
    }

    #[inline(always)]
    fn numbers_of(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        let mut numbers = [0.0; STRIP];
        let counts = count.steps.iter().zip(count.bias);
        for ((number, sum), (step, bias)) in numbers.iter_mut().zip(sums).zip(counts) {
            *number = *bias + *sum as f32 * (count.step * step);
        }
        if count.relu { numbers.map(relu) } else { numbers }
    }
}

/// Adds what was not listed: the last of `all` pairs, where there are many.
#[cold]
#[inline(never)]
fn add_rest(
    (rows, half): (&[[Part; 2]], usize),
    rest: &[Pair],
    (all, strips): (usize, usize),
    sums: &mut [i32; PART],
) {
    let rows = rows.get((all - rest.len()) * strips..).unwrap_or(&[]).iter();
    for (row, pair) in rows.step_by(strips.max(1)).zip(rest) {
        if let Some(columns) = row.get(half) {
            add(sums, columns, *pair);
        }
    }
}

/// Rows of weights, each as two times eight columns, whose words are aligned: weights are.
#[inline(always)]
fn halves(rows: &[Row]) -> &[[Part; 2]] {
    <[_]>::ref_from_bytes(rows.as_bytes()).unwrap_or(&[])
}

/// The outputs of a product, part after part, with what makes numbers of their sums.
struct Parts<'a> {
    outputs: IterMut<'a, [f32; PART]>,
    steps: Iter<'a, [f32; PART]>,
    bias: Iter<'a, [f32; PART]>,
    step: f32,
    relu: bool,
}

impl<'a> Parts<'a> {
    #[inline(always)]
    fn of(matrix: &Matrix<'a>, step: f32, outputs: &'a mut [f32]) -> Self {
        Self {
            outputs: outputs.as_chunks_mut().0.iter_mut(),
            steps: matrix.steps.as_chunks().0.iter(),
            bias: matrix.bias.unwrap_or(&[]).as_chunks().0.iter(),
            step,
            relu: matrix.relu,
        }
    }

    /// Fills the next part; nothing where there is none, behind the last columns.
    #[inline(never)]
    fn fill(&mut self, sums: &[i32; PART]) {
        let (Some(outputs), Some(steps)) = (self.outputs.next(), self.steps.next()) else { return };
        let counts = steps.iter().zip(self.bias.next().unwrap_or(&[0.0; PART]));
        let mut numbers = [0.0; PART];
        for ((number, sum), (step, bias)) in numbers.iter_mut().zip(sums).zip(counts) {
            *number = *bias + *sum as f32 * (self.step * step);
        }
        *outputs = if self.relu { numbers.map(relu) } else { numbers };
    }
}
