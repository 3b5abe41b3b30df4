//! Layers of int8 weights on the patches of a picture.

use super::{Count, Lanes, Pair, Row, STRIP};
use crate::kernels::patches::{Patches, Runs, Tiles};

/// A layer of int8 weights on patches.
#[derive(Clone, Copy, Debug)]
pub struct Int8PatchLayer<'a> {
    /// The patches.
    pub patches: &'a Patches,
    /// Strip after strip, in each a row for every pair of numbers of every run; behind an odd run stands a zero.
    pub rows: &'a [Row],
    /// What a weight of each output counts, whole strips.
    pub steps: &'a [f32],
    /// What is added to each output, whole strips.
    pub bias: &'a [f32],
    /// Whether a ReLU follows.
    pub relu: bool,
    /// Outputs.
    pub outputs: usize,
}

/// Adds up patches of integers.
pub(crate) trait AddIntegerRuns: Copy {
    /// The sums of every patch that starts `at` a place.
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT];

    /// Sums as numbers ([`Lanes::numbers`]).
    fn numbers_of(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP];
}

impl<L: Lanes> AddIntegerRuns for L {
    #[inline(always)]
    fn add_runs<const COUNT: usize>(
        self,
        rows: &[Row],
        runs: Runs<'_, i16>,
        at: [usize; COUNT],
    ) -> [[i32; STRIP]; COUNT] {
        Lanes::add_runs(self, rows, runs, at)
    }

    #[inline(always)]
    fn numbers_of(self, sums: &[i32; STRIP], count: Count<'_>) -> [f32; STRIP] {
        self.numbers(sums, count)
    }
}

/// The strips of a layer.
pub(crate) struct IntegerTiles<'a, L> {
    lanes: L,
    layer: &'a Int8PatchLayer<'a>,
    runs: Runs<'a, i16>,
    /// What an integer counts.
    step: f32,
}

impl<'a, L> IntegerTiles<'a, L> {
    #[inline(always)]
    pub(crate) fn of(
        lanes: L,
        layer: &'a Int8PatchLayer<'a>,
        (integers, step): (&'a [i16], f32),
    ) -> Self {
        Self { lanes, layer, runs: Runs::of(layer.patches, integers), step }
    }
}

impl<L: AddIntegerRuns> Tiles for IntegerTiles<'_, L> {
    #[inline(always)]
    fn tile<const COUNT: usize>(&self, tile: usize, at: [usize; COUNT]) -> [[f32; STRIP]; COUNT] {
        let rows = self.runs.total() * self.runs.length.div_ceil(2);
        let rows = self.layer.rows.get(tile * rows..(tile + 1) * rows).unwrap_or(&[]);
        let sums = self.lanes.add_runs(rows, self.runs, at);
        let part =
            |floats: &'_ [f32]| floats.as_chunks().0.get(tile).copied().unwrap_or([0.0; STRIP]);
        let (steps, bias) = (&part(self.layer.steps), &part(self.layer.bias));
        let count = Count { step: self.step, steps, bias, relu: self.layer.relu };
        let mut numbers = [[0.0; STRIP]; COUNT];
        for (numbers, sums) in numbers.iter_mut().zip(&sums) {
            *numbers = self.lanes.numbers_of(sums, count);
        }
        numbers
    }
}

/// [`AddIntegerRuns::add_runs`] as every processor of the target runs it, by what adds a row times its pair.
#[inline(always)]
pub(crate) fn add_runs<const COUNT: usize>(
    rows: &[Row],
    runs: Runs<'_, i16>,
    at: [usize; COUNT],
    add: impl Fn(&mut [i32; STRIP], &Row, Pair),
) -> [[i32; STRIP]; COUNT] {
    let mut sums = [[0; STRIP]; COUNT];
    let mut rows = rows;
    for outer in 0..runs.counts[0] {
        for inner in 0..runs.counts[1] {
            let run = outer * runs.steps[0] + inner * runs.steps[1];
            let Some(rows) = rows.split_off(..runs.length.div_ceil(2)) else { return sums };
            for (sums, at) in sums.iter_mut().zip(at) {
                let integers = runs.from.get(at + run..).unwrap_or(&[]);
                for (row, pair) in rows.iter().zip(integers.as_chunks().0) {
                    add(sums, row, *pair);
                }
            }
        }
    }
    sums
}
