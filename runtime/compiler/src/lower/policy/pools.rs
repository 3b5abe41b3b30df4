//! Pools: one number of every patch of a picture, channel by channel.
//!
//! The numbers that stand beside each other in a patch are reduced first, then those that stand above each other.

use sortie_core::internal::ops::{Combination, Function, Place, Reduction};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::cnn::{MaxPool, SumPool};

use super::arrange::Dimension;
use super::convolve::{Patches, area};
use super::values::Value;
use super::{Lowered, Lowering};

impl Lowering<'_> {
    /// The largest number of every patch.
    pub(super) fn largest(&mut self, node: &TypedNode, pool: &MaxPool) -> Lowered<()> {
        if pool.with_index_outputs.is_some() {
            return Err(self.unsupported(node, "plans do not say where the largest number stands"));
        }
        let value = self.operand(node, 0)?;
        let value = self.channels_first(node, &pool.pool_spec, value)?;
        let patches = self.patches(node, &pool.pool_spec, &value)?;
        let to = self.pooled(node, &patches, &value, Reduction::Maximum, f32::MIN)?;
        let to = self.as_picture(node, &pool.pool_spec, &patches, patches.channels, to)?;
        self.give(node, 0, to)
    }

    /// The sum or the mean of every patch.
    pub(super) fn sum(&mut self, node: &TypedNode, pool: &SumPool) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let value = self.channels_first(node, &pool.pool_spec, value)?;
        let patches = self.patches(node, &pool.pool_spec, &value)?;
        let sum = self.pooled(node, &patches, &value, Reduction::Sum, 0.0)?;
        let to = if pool.normalize { self.mean(&patches, pool, sum) } else { sum };
        let to = self.as_picture(node, &pool.pool_spec, &patches, patches.channels, to)?;
        self.give(node, 0, to)
    }

    /// Divides sums by how many points they are of.
    fn mean(&mut self, patches: &Patches, pool: &SumPool, sum: Place) -> Place {
        let counts: Vec<f32> = match pool.count_include_pad {
            true => vec![area(patches.kernel) as f32],
            false => patches.counts(),
        };
        let first = counts.first().copied().unwrap_or(1.0);
        if counts.iter().all(|count| *count == first) {
            return self.map(Function::Affine, [1.0 / first, 0.0], sum);
        }
        let shares: Vec<f32> = counts.iter().map(|count| 1.0 / count.max(1.0)).collect();
        let shares = self.stored(&shares.repeat(patches.pictures * patches.channels));
        self.combine(Combination::Multiply, sum, shares)
    }

    /// What becomes of every patch; points outside of the picture are `fill`.
    fn pooled(
        &mut self,
        node: &TypedNode,
        patches: &Patches,
        value: &Value,
        reduction: Reduction,
        fill: f32,
    ) -> Lowered<Place> {
        let (from, [height, width]) = self.framed(node, patches, value, fill)?;
        let channels = patches.pictures * patches.channels;
        let ([rows, columns], [tall, wide]) = (patches.result, patches.kernel);
        let beside = self.arena.place(channels * height * columns * wide);
        let of = |size, from, to| Dimension { size, from, to };
        let dimensions = [
            of(channels * height, width, columns * wide),
            of(columns, patches.stride[1], wide),
            of(wide, patches.dilation[1], 1),
        ];
        self.arrange(node, from, beside, &dimensions)?;
        let lines = self.reduced(reduction, wide, beside);
        let above = self.arena.place(channels * rows * columns * tall);
        let dimensions = [
            of(channels, height * columns, rows * columns * tall),
            of(rows, patches.stride[0] * columns, columns * tall),
            of(columns, 1, tall),
            of(tall, patches.dilation[0] * columns, 1),
        ];
        self.arrange(node, lines, above, &dimensions)?;
        Ok(self.reduced(reduction, tall, above))
    }

    /// A picture with all points that patches reach, and its sizes.
    fn framed(
        &mut self,
        node: &TypedNode,
        patches: &Patches,
        value: &Value,
        fill: f32,
    ) -> Lowered<(Place, [usize; 2])> {
        let [height, width] = patches.size;
        let framed = [0, 1].map(|direction| {
            let last = (patches.result[direction].max(1) - 1) * patches.stride[direction];
            let reach = last + (patches.kernel[direction].max(1) - 1) * patches.dilation[direction];
            (patches.before[direction] + patches.size[direction]).max(reach + 1)
        });
        if framed == patches.size {
            return Ok((value.place, framed));
        }
        let [above, left] = patches.before;
        let channels = patches.pictures * patches.channels;
        let to = self.arena.place(channels * area(framed));
        let of = |size, from, to| Dimension { size, from, to };
        let frame = self.stored(&[fill]);
        self.arrange(node, frame, to, &[of(to.len as usize, 0, 1)])?;
        let skipped = (above * framed[1] + left) as u32;
        let inner = Place { offset: to.offset + skipped, len: to.len - skipped };
        let dimensions = [
            of(channels, height * width, area(framed)),
            of(height, width, framed[1]),
            of(width, 1, 1),
        ];
        self.arrange(node, value.place, inner, &dimensions)?;
        Ok((to, framed))
    }
}

impl Patches {
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
