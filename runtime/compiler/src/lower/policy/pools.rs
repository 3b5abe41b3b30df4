//! Pools: one number of every channel of every patch; and layers on each channel by itself.

use sortie_core::internal::ops::{Combination, Flag, Fold, FoldPatches, Op, Patches};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::cnn::{MaxPool, SumPool};

use super::convolve::tiles;
use super::windows::{Source, Target, Windows, area, part};
use super::{Lowered, Lowering};

impl Lowering<'_> {
    /// The largest number of every patch.
    pub(super) fn largest(&mut self, node: &TypedNode, pool: &MaxPool) -> Lowered<()> {
        if pool.with_index_outputs.is_some() {
            return Err(self.unsupported(node, "plans do not say where the largest number stands"));
        }
        let windows = self.windows(node, &pool.pool_spec)?;
        let source = self.source(node, &pool.pool_spec, &windows)?;
        let source = self.as_points(node, &windows, source)?;
        let source = self.framed(node, &windows, source, f32::MIN)?;
        let channels = windows.channels;
        let to = self.arena.place(windows.pictures * channels * area(windows.result));
        let patches = windows.patches(source, channels);
        let (fold, relu, from) = (Fold::Maximum, Flag::No, source.place);
        let step = FoldPatches { fold, weights: 0, bias: 0, relu, patches, from, to };
        self.fold_by(&windows, source, step, windows.target(to, channels));
        self.give_picture(node, &pool.pool_spec, windows.picture(to, channels))
    }

    /// The sum or the mean of every patch.
    pub(super) fn sum(&mut self, node: &TypedNode, pool: &SumPool) -> Lowered<()> {
        let windows = self.windows(node, &pool.pool_spec)?;
        let source = self.source(node, &pool.pool_spec, &windows)?;
        let source = self.as_points(node, &windows, source)?;
        let source = self.framed(node, &windows, source, 0.0)?;
        let counts: Vec<f32> = match (pool.normalize, pool.count_include_pad) {
            (false, _) => vec![1.0],
            (true, true) => vec![area(windows.kernel) as f32],
            (true, false) => windows.counts(),
        };
        let first = counts.first().copied().unwrap_or(1.0);
        let is_same = counts.iter().all(|count| *count == first);
        let share = if is_same { 1.0 / first } else { 1.0 };
        let channels = windows.channels;
        let to = self.arena.place(windows.pictures * channels * area(windows.result));
        let (weights, bias) = (vec![share; channels * area(windows.kernel)], vec![0.0; channels]);
        let target = windows.target(to, channels);
        self.fold(&windows, source, (&weights, &bias), Flag::No, target);
        let to = if is_same {
            to
        } else {
            let share = |count: &f32| std::iter::repeat_n(1.0 / count.max(1.0), channels);
            let shares: Vec<f32> = counts.iter().flat_map(share).collect();
            let shares = self.stored(&shares.repeat(windows.pictures));
            self.combine(Combination::Multiply, to, shares)
        };
        self.give_picture(node, &pool.pool_spec, windows.picture(to, channels))
    }

    /// A weighted sum of every channel of every patch: a weight of every channel for each point.
    pub(super) fn fold(
        &mut self,
        windows: &Windows,
        source: Source,
        (weights, bias): (&[f32], &[f32]),
        relu: Flag,
        target: Target,
    ) {
        let mut add = |values| self.weights.add_numbers(&tiles(values, windows.channels));
        let (weights, bias) = (add(weights), add(bias));
        let (patches, from, to) =
            (windows.patches(source, windows.channels), source.place, target.place);
        let step = FoldPatches { fold: Fold::Sum, weights, bias, relu, patches, from, to };
        self.fold_by(windows, source, step, target);
    }

    /// The same step for every picture.
    fn fold_by(&mut self, windows: &Windows, source: Source, step: FoldPatches, target: Target) {
        let channels = windows.channels as u32;
        let patches = Patches { to_steps: [target.row as u32, channels], ..step.patches };
        for picture in 0..windows.pictures {
            let from = part(source.place, source.each * picture, patches.reach());
            let first = target.first + target.each * picture;
            let to = part(target.place, first, patches.result_reach(channels));
            self.ops.push(Op::FoldPatches(FoldPatches { patches, from, to, ..step }));
        }
    }
}

impl Windows {
    /// The points of every patch that lie in the picture.
    fn counts(&self) -> Vec<f32> {
        let along = |direction: usize| {
            let inside = move |patch: usize, point: usize| {
                let at = patch * self.stride[direction] + point * self.dilation[direction];
                let at = at.checked_sub(self.before[direction]);
                at.is_some_and(|at| at < self.size[direction])
            };
            let points = 0..self.kernel[direction];
            let count = move |patch| points.clone().filter(|point| inside(patch, *point)).count();
            (0..self.result[direction]).map(count).collect::<Vec<usize>>()
        };
        let (rows, columns) = (along(0), along(1));
        let of_row = |row: &usize| columns.iter().map(|column| (row * column) as f32).collect();
        rows.iter().flat_map(|row| -> Vec<f32> { of_row(row) }).collect()
    }
}
