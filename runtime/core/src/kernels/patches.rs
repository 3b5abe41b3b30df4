//! Layers on the patches of a picture: sums of sixteen outputs for several patches at once, which stay in registers.
//!
//! A patch is some runs of neighbouring numbers, and the next patch is the same a few numbers further on. So one loop serves
//! every stride, dilation and kernel, and pictures whose points stand side by side or whose channels do. A sum starts at
//! its bias; numbers are added one after the other, run after run.

use core::marker::PhantomData;

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::arithmetic::Arithmetic;
use super::product::{Around, add_row, finished};
use super::several::PART;
use crate::math::relu_all;

/// Where patches and what is made of them stand, in numbers behind the start of a picture and of its result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Patches {
    /// Patches, down and to the right.
    pub count: [u32; 2],
    /// From one patch to the next, down and to the right.
    pub steps: [u32; 2],
    /// Runs of a patch: outer and inner ones.
    pub runs: [u32; 2],
    /// From one run to the next, of outer and inner ones.
    pub run_steps: [u32; 2],
    /// Numbers of a run.
    pub run: u32,
    /// From what is made of one patch to that of the next, down and to the right.
    pub to_steps: [u32; 2],
}

impl Patches {
    /// How many there are.
    pub fn total(&self) -> u64 {
        product(self.count)
    }

    /// Runs of a patch.
    pub fn total_runs(&self) -> u64 {
        product(self.runs)
    }

    /// Numbers of a patch.
    pub fn inputs(&self) -> u64 {
        self.total_runs().saturating_mul(self.run.into())
    }

    /// Numbers of a picture up to the last that a patch reaches.
    pub fn reach(&self) -> u64 {
        let last = last(self.count, self.steps).saturating_add(last(self.runs, self.run_steps));
        last.saturating_add(self.run.into())
    }

    /// Numbers of the result up to the last, where `outputs` are made of a patch.
    pub fn result_reach(&self, outputs: u32) -> u64 {
        last(self.count, self.to_steps).saturating_add(outputs.into())
    }
}

fn product([a, b]: [u32; 2]) -> u64 {
    u64::from(a) * u64::from(b)
}

/// Where the last of some things starts that stand in two dimensions.
fn last(count: [u32; 2], steps: [u32; 2]) -> u64 {
    let along = |count: u32, step: u32| u64::from(count.saturating_sub(1)) * u64::from(step);
    along(count[0], steps[0]).saturating_add(along(count[1], steps[1]))
}

/// A layer on patches.
#[derive(Clone, Copy, Debug)]
pub struct PatchLayer<'a> {
    /// The patches.
    pub patches: &'a Patches,
    /// Tiles of sixteen outputs, in each a row of sixteen for every number of a patch.
    pub weights: &'a [f32],
    /// Bias, padded to whole tiles, and ReLU.
    pub around: Around<'a>,
    /// Outputs.
    pub outputs: usize,
}

/// What becomes of a channel's numbers in a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u32)]
#[non_exhaustive]
pub enum Fold {
    /// Its sum, each number times its weight.
    Sum,
    /// Its largest number.
    Maximum,
}

/// The runs of patches, among the numbers of a picture.
#[derive(Clone, Copy, Debug)]
pub struct Runs<'a, T> {
    /// The picture.
    pub from: &'a [T],
    /// Outer and inner runs.
    pub counts: [usize; 2],
    /// From one to the next.
    pub steps: [usize; 2],
    /// Numbers of a run.
    pub length: usize,
}

impl<'a, T> Runs<'a, T> {
    pub(super) fn of(patches: &Patches, from: &'a [T]) -> Self {
        Self {
            from,
            counts: patches.runs.map(|count| count as usize),
            steps: patches.run_steps.map(|step| step as usize),
            length: patches.run as usize,
        }
    }

    /// How many there are.
    pub(super) fn total(&self) -> usize {
        self.counts[0].saturating_mul(self.counts[1])
    }

    /// Whether all runs of some patches lie inside the picture, rounded up to whole groups of numbers, and a tile has as many rows
    /// as a patch has groups.
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    #[inline(always)]
    pub(super) fn are_inside(&self, at: &[usize], rows: usize, group: usize) -> bool {
        let [outer, inner] = self.counts.map(|count| count.saturating_sub(1));
        let last =
            outer.saturating_mul(self.steps[0]).saturating_add(inner.saturating_mul(self.steps[1]));
        let groups = self.length.div_ceil(group);
        let reach = last.saturating_add(groups.saturating_mul(group));
        let most = at.iter().copied().fold(0, usize::max);
        self.total().saturating_mul(groups) <= rows && most.saturating_add(reach) <= self.from.len()
    }
}

/// A walk over patches, row after row.
struct Walk {
    /// Patches behind the next one.
    behind: usize,
    columns: usize,
    column: usize,
    /// The next patch and its result, and the first of their row.
    next: [usize; 2],
    row: [usize; 2],
    down: [usize; 2],
    right: [usize; 2],
}

impl Walk {
    #[inline(always)]
    fn over(patches: &Patches) -> Self {
        let [rows, columns] = patches.count.map(|count| count as usize);
        let [[from_down, from_right], [to_down, to_right]] =
            [patches.steps, patches.to_steps].map(|steps| steps.map(|step| step as usize));
        Self {
            behind: rows.saturating_mul(columns).saturating_sub(1),
            columns,
            column: 0,
            next: [0; 2],
            row: [0; 2],
            down: [from_down, to_down],
            right: [from_right, to_right],
        }
    }

    /// Where the next patches start, and their results; the last one again where there are no more.
    #[inline(always)]
    fn next<const COUNT: usize>(&mut self) -> [[usize; COUNT]; 2] {
        let [mut from, mut to] = [[0; COUNT]; 2];
        for (from, to) in from.iter_mut().zip(&mut to) {
            [*from, *to] = self.next;
            if self.behind > 0 {
                self.behind -= 1;
                self.advance();
            }
        }
        [from, to]
    }

    #[inline(always)]
    fn advance(&mut self) {
        self.column += 1;
        let add = |[from, to]: [usize; 2], step: [usize; 2]| {
            [from.wrapping_add(step[0]), to.wrapping_add(step[1])]
        };
        if self.column < self.columns {
            self.next = add(self.next, self.right);
        } else {
            self.column = 0;
            self.row = add(self.row, self.down);
            self.next = self.row;
        }
    }
}

/// Adds up patches.
pub(super) trait AddRuns: Copy {
    /// For every patch that starts `at` a place `start`, plus each of its numbers times the row of the tile, one number after the
    /// other.
    fn add_runs<A: Arithmetic, const COUNT: usize>(
        self,
        tile: &[[f32; PART]],
        runs: Runs<'_, f32>,
        at: [usize; COUNT],
        start: [f32; PART],
    ) -> [[f32; PART]; COUNT];
}

/// A layer of which tiles of sixteen outputs are computed for several patches at once.
pub(super) trait Tiles {
    /// What the outputs of a tile are for patches that start `at` some places.
    fn tile<const COUNT: usize>(&self, tile: usize, at: [usize; COUNT]) -> [[f32; PART]; COUNT];
}

/// Writes so many outputs for every patch: for `MANY` patches at once, for `FEW` where no more are left.
#[inline(always)]
pub(super) fn convolve<const MANY: usize, const FEW: usize>(
    layer: &impl Tiles,
    (patches, outputs): (&Patches, usize),
    to: &mut [f32],
) {
    let mut walk = Walk::over(patches);
    let mut left = walk.behind + 1;
    while left > 0 {
        if MANY == FEW || left > FEW {
            convolve_some::<MANY>(layer, outputs, walk.next(), to);
            left = left.saturating_sub(MANY);
        } else {
            convolve_some::<FEW>(layer, outputs, walk.next(), to);
            left = left.saturating_sub(FEW);
        }
    }
}

#[inline(always)]
fn convolve_some<const COUNT: usize>(
    layer: &impl Tiles,
    outputs: usize,
    [from, places]: [[usize; COUNT]; 2],
    to: &mut [f32],
) {
    for (tile, first) in (0..outputs).step_by(PART).enumerate() {
        let numbers = layer.tile(tile, from);
        for (numbers, place) in numbers.iter().zip(places) {
            let to = to.get_mut(place..place.saturating_add(outputs));
            if let Some(to) = to.and_then(|to| to.get_mut(first..)) {
                write(to, *numbers);
            }
        }
    }
}

/// The tiles of a layer of floats.
pub(super) struct FloatTiles<'a, A, R> {
    adder: R,
    layer: &'a PatchLayer<'a>,
    runs: Runs<'a, f32>,
    arithmetic: PhantomData<A>,
}

impl<'a, A, R> FloatTiles<'a, A, R> {
    #[inline(always)]
    pub(super) fn of(adder: R, layer: &'a PatchLayer<'a>, from: &'a [f32]) -> Self {
        let runs = Runs::of(layer.patches, from);
        Self { adder, layer, runs, arithmetic: PhantomData }
    }
}

impl<A: Arithmetic, R: AddRuns> Tiles for FloatTiles<'_, A, R> {
    #[inline(always)]
    fn tile<const COUNT: usize>(&self, tile: usize, at: [usize; COUNT]) -> [[f32; PART]; COUNT] {
        let Around { bias, relu } = self.layer.around;
        let start = bias.unwrap_or(&[]).as_chunks().0.get(tile).copied().unwrap_or([0.0; PART]);
        let rows = self.runs.total() * self.runs.length;
        let rows = self.layer.weights.as_chunks().0.get(tile * rows..(tile + 1) * rows);
        let mut sums = self.adder.add_runs::<A, COUNT>(rows.unwrap_or(&[]), self.runs, at, start);
        if relu {
            // All at once: patch by patch, compilers would work on all patches' first numbers, then on their second ones.
            relu_all(sums.as_flattened_mut());
        }
        sums
    }
}

/// Writes numbers, as far as there is room for them.
#[inline(always)]
pub(super) fn write(to: &mut [f32], numbers: [f32; PART]) {
    if let Some(to) = to.first_chunk_mut() {
        *to = numbers;
    } else {
        to.iter_mut().zip(numbers).for_each(|(to, number)| *to = number);
    }
}

/// [`AddRuns::add_runs`] as every processor of the target runs it.
#[inline(always)]
pub(super) fn add_runs<A: Arithmetic, const COUNT: usize>(
    tile: &[[f32; PART]],
    runs: Runs<'_, f32>,
    at: [usize; COUNT],
    start: [f32; PART],
) -> [[f32; PART]; COUNT] {
    let mut sums = [start; COUNT];
    let mut rows = tile;
    for outer in 0..runs.counts[0] {
        for inner in 0..runs.counts[1] {
            let run = outer * runs.steps[0] + inner * runs.steps[1];
            let mut numbers = [&[] as &[f32]; COUNT];
            for (numbers, at) in numbers.iter_mut().zip(at) {
                *numbers = runs.from.get(at + run..).unwrap_or(&[]);
            }
            let Some(rows) = rows.split_off(..runs.length) else { return sums };
            for (index, row) in rows.iter().enumerate() {
                for (sums, numbers) in sums.iter_mut().zip(numbers) {
                    add_row::<A, PART>(sums, numbers.get(index).copied().unwrap_or(0.0), row);
                }
            }
        }
    }
    sums
}

/// Writes what becomes of every channel of every patch; a patch is a run of all channels for each of its points, and weights
/// are a row for each point in every tile of channels.
#[inline(always)]
pub(super) fn fold<A: Arithmetic>(layer: &PatchLayer<'_>, by: Fold, from: &[f32], to: &mut [f32]) {
    match by {
        Fold::Sum => fold_by::<A, false>(layer, from, to),
        Fold::Maximum => fold_by::<A, true>(layer, from, to),
    }
}

#[inline(always)]
fn fold_by<A: Arithmetic, const MAXIMUM: bool>(
    layer: &PatchLayer<'_>,
    from: &[f32],
    to: &mut [f32],
) {
    let (runs, mut walk) = (Runs::of(layer.patches, from), Walk::over(layer.patches));
    for _ in 0..=walk.behind {
        let [[at], [place]] = walk.next();
        let Some(to) = to.get_mut(place..place.saturating_add(layer.outputs)) else { return };
        let mut rows = layer.weights.as_chunks().0;
        let mut bias = layer.around.bias.unwrap_or(&[]).as_chunks().0.iter();
        for (first, to) in (0..).step_by(PART).zip(to.chunks_mut(PART)) {
            let start = if MAXIMUM { f32::NEG_INFINITY } else { 0.0 };
            let mut folded = bias.next().copied().unwrap_or([start; PART]);
            let mut tile = rows.split_off(..runs.total()).unwrap_or(&[]).iter();
            for outer in 0..runs.counts[0] {
                for inner in 0..runs.counts[1] {
                    let run = outer * runs.steps[0] + inner * runs.steps[1];
                    let numbers = lanes(from, at + run + first);
                    let weights = tile.next().unwrap_or(&[1.0; PART]);
                    for ((folded, number), weight) in folded.iter_mut().zip(numbers).zip(weights) {
                        *folded = if MAXIMUM {
                            larger(*folded, number)
                        } else {
                            A::multiply_add(*folded, number, *weight)
                        };
                    }
                }
            }
            write(to, finished(folded, layer.around.relu));
        }
    }
}

/// Numbers side by side; zeros behind the last.
#[inline(always)]
fn lanes(from: &[f32], first: usize) -> [f32; PART] {
    let from = from.get(first..).unwrap_or(&[]);
    if let Some(lanes) = from.first_chunk() {
        return *lanes;
    }
    let mut lanes = [0.0; PART];
    for (lane, number) in lanes.iter_mut().zip(from) {
        *lane = *number;
    }
    lanes
}

/// NaN stays NaN.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a || b.is_nan() { b } else { a }
}

#[cfg(test)]
mod tests;
