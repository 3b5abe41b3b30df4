//! The patches that convolutions and pools work on, and where pictures stand.

use sortie_core::internal::ops::{Patches, Place};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::cnn::PoolSpec;

use super::pictures::Picture;
use super::{Dimension, Lowered, Lowering};

/// Patches of pictures, each number down and to the right.
pub(super) struct Windows {
    pub(super) pictures: usize,
    pub(super) channels: usize,
    pub(super) size: [usize; 2],
    pub(super) kernel: [usize; 2],
    pub(super) stride: [usize; 2],
    pub(super) dilation: [usize; 2],
    /// Points outside of the picture, above it and on its left.
    pub(super) before: [usize; 2],
    pub(super) result: [usize; 2],
}

/// Pictures as patches read them, with all points that these reach.
#[derive(Clone, Copy)]
pub(super) struct Source {
    pub(super) place: Place,
    /// Numbers from a channel, a row and a column to the next.
    pub(super) steps: [usize; 3],
    /// From one picture to the next.
    pub(super) each: usize,
}

impl Source {
    /// Whether the channels of a point stand side by side.
    pub(super) fn has_points(&self) -> bool {
        self.steps[0] == 1
    }
}

/// What is made of patches: pictures whose channels stand side by side, with a border or without.
#[derive(Clone, Copy)]
pub(super) struct Target {
    pub(super) place: Place,
    /// The first number inside the border.
    pub(super) first: usize,
    /// From a row to the next.
    pub(super) row: usize,
    /// From a picture to the next.
    pub(super) each: usize,
}

impl Lowering<'_> {
    /// The patches that a convolution or a pool works on.
    pub(super) fn windows(&self, node: &TypedNode, spec: &PoolSpec) -> Lowered<Windows> {
        let outlet = self.outlet(node, 0)?;
        let fact = self.model.outlet_fact(outlet).ok().and_then(|fact| fact.shape.as_concrete());
        let shape = fact.and_then(|shape| spec.data_format.shape(shape.to_vec()).ok());
        let shape = shape.ok_or_else(|| self.unsupported(node, "its picture has other sizes"))?;
        if !(1..=2).contains(&shape.hw_rank()) {
            let hint = "plans take pictures of one or two dimensions";
            return Err(self.unsupported(node, hint));
        }
        let padding = spec.computed_padding(shape.hw_dims());
        // A line is a picture of one row.
        let both = |of: &dyn Fn(usize) -> usize, line: usize| match shape.hw_rank() {
            1 => [line, of(0)],
            _ => [of(0), of(1)],
        };
        Ok(Windows {
            pictures: shape.n().copied().unwrap_or(1),
            channels: *shape.c(),
            size: both(&|axis| shape.hw_dims()[axis], 1),
            kernel: both(&|axis| spec.kernel_shape[axis], 1),
            stride: both(&|axis| spec.stride(axis), 1),
            dilation: both(&|axis| spec.dilation(axis), 1),
            before: both(&|axis| padding[axis].pad_before, 0),
            result: both(&|axis| padding[axis].convoluted, 1),
        })
    }

    /// Where the pictures of a convolution or a pool stand.
    pub(super) fn source(
        &mut self,
        node: &TypedNode,
        spec: &PoolSpec,
        windows: &Windows,
    ) -> Lowered<Source> {
        let outlet = self.outlet(node, 0)?;
        if let Some(place) = self.values.framed(outlet) {
            return Ok(Windows { size: windows.framed(), ..*windows }.points(place));
        }
        Ok(match self.values.picture(outlet) {
            _ if spec.data_format.c_is_last() => windows.points(self.operand(node, 0)?.place),
            Some(picture) => windows.points(picture.place),
            None => windows.planes(self.operand(node, 0)?.place),
        })
    }

    /// A result with its channels where the graph has them.
    pub(super) fn give_picture(
        &mut self,
        node: &TypedNode,
        spec: &PoolSpec,
        picture: Picture,
    ) -> Lowered<()> {
        if spec.data_format.c_is_last() {
            return self.give(node, 0, picture.place);
        }
        self.values.insert_picture((node.id, 0).into(), picture);
        Ok(())
    }

    /// Pictures with the channels of a point side by side.
    pub(super) fn as_points(
        &mut self,
        node: &TypedNode,
        windows: &Windows,
        from: Source,
    ) -> Lowered<Source> {
        if from.has_points() {
            return Ok(from);
        }
        let to = windows.points(self.arena.place(from.place.len as usize));
        let of = |size, from, to| Dimension { size, from, to };
        let points = area(windows.size);
        let mut dimensions = [
            of(windows.pictures, from.each, to.each),
            of(windows.channels, from.steps[0], to.steps[0]),
            of(points, 1, windows.channels),
        ];
        if windows.channels > points {
            dimensions.swap(1, 2);
        }
        self.arrange(node, from.place, to.place, &dimensions)?;
        Ok(to)
    }

    /// Pictures with all points that patches reach; those around are `fill`.
    pub(super) fn framed(
        &mut self,
        node: &TypedNode,
        windows: &Windows,
        from: Source,
        fill: f32,
    ) -> Lowered<Source> {
        let framed = windows.framed();
        if from.place.len as usize == windows.pictures * windows.channels * area(framed) {
            return Ok(from);
        }
        let place = self.arena.place(windows.pictures * windows.channels * area(framed));
        let whole = Windows { size: framed, ..*windows };
        let to = if from.has_points() { whole.points(place) } else { whole.planes(place) };
        self.filled(node, place, fill)?;
        let of = |size, from, to| Dimension { size, from, to };
        let [above, left] = windows.before;
        let skipped = above * to.steps[1] + left * to.steps[2];
        let inner = part(place, skipped, u64::from(place.len) - skipped as u64);
        let [height, width] = windows.size;
        let dimensions = if from.has_points() {
            let row = width * windows.channels;
            [
                of(windows.pictures, from.each, to.each),
                of(height, from.steps[1], to.steps[1]),
                of(row, 1, 1),
            ]
        } else {
            let planes = windows.pictures * windows.channels;
            [of(planes, from.steps[0], to.steps[0]), of(height, width, framed[1]), of(width, 1, 1)]
        };
        self.arrange(node, from.place, inner, &dimensions)?;
        Ok(Source { place, ..to })
    }

    /// The same number everywhere.
    pub(super) fn filled(&mut self, node: &TypedNode, place: Place, fill: f32) -> Lowered<()> {
        let fill = self.stored(&[fill]);
        self.arrange(node, fill, place, &[Dimension { size: place.len as usize, from: 0, to: 1 }])
    }
}

/// The points of a grid.
pub(super) fn area([height, width]: [usize; 2]) -> usize {
    height * width
}

/// Some floats of a place.
pub(super) fn part(place: Place, first: usize, len: u64) -> Place {
    Place { offset: place.offset + first as u32, len: len as u32 }
}

impl Windows {
    /// Where pictures stand whose channels stand side by side.
    pub(super) fn points(&self, place: Place) -> Source {
        let [height, width] = self.size;
        let row = width * self.channels;
        Source { place, steps: [1, row, self.channels], each: height * row }
    }

    /// Where they stand if points of a channel do.
    pub(super) fn planes(&self, place: Place) -> Source {
        let [height, width] = self.size;
        let plane = height * width;
        Source { place, steps: [plane, width, 1], each: self.channels * plane }
    }

    /// What is made of the patches.
    pub(super) fn picture(&self, place: Place, channels: usize) -> Picture {
        Picture { place, count: self.pictures, points: area(self.result), channels }
    }

    /// The size of a picture with all points that patches reach.
    pub(super) fn framed(&self) -> [usize; 2] {
        [0, 1].map(|way| {
            let last = (self.result[way].max(1) - 1) * self.stride[way];
            let reach = last + (self.kernel[way].max(1) - 1) * self.dilation[way];
            (self.before[way] + self.size[way]).max(reach + 1)
        })
    }

    /// Results of so many channels without a border.
    pub(super) fn target(&self, place: Place, channels: usize) -> Target {
        let row = self.result[1] * channels;
        Target { place, first: 0, row, each: self.result[0] * row }
    }

    /// The patches of some of the channels of a picture; where results go is not said yet.
    pub(super) fn patches(&self, source: Source, channels: usize) -> Patches {
        let whole = |numbers: [usize; 2]| numbers.map(|number| number as u32);
        let [plane, row, column] = source.steps;
        let [down, right] = [self.dilation[0] * row, self.dilation[1] * column];
        let [rows, columns] = self.kernel;
        let (runs, run_steps, run) = if source.has_points() {
            ([rows, columns], [down, right], channels)
        } else {
            ([channels, rows], [plane, down], columns)
        };
        Patches {
            count: whole(self.result),
            steps: whole([self.stride[0] * row, self.stride[1] * column]),
            runs: whole(runs),
            run_steps: whole(run_steps),
            run: run as u32,
            to_steps: [0; 2],
        }
    }
}
